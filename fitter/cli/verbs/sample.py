"""``brdf-fitter sample``: draw scattered directions from a raw table or from a fitted model."""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.values import output_file
from fitter.cli.verb import Outcome, Verb
from fitter.errors import SpecError

if TYPE_CHECKING:
    from fitter.sampling import Samples

#: Draws that are printed as JSON at most; more belong in a file.
MOST_PRINTED = 100_000


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "table", nargs="?", metavar="TABLE", help="draw from this measured table, exactly, by rejection"
    )
    parser.add_argument("--model", metavar="RESULT.json", help="draw from this fitted model instead")
    parser.add_argument("--theta-i", type=float, required=True, metavar="DEG", help="incident polar angle")
    parser.add_argument(
        "--phi-i", type=float, default=0.0, metavar="DEG", help="incident azimuth (default: 0)"
    )
    parser.add_argument("-n", "--count", type=int, required=True, metavar="N", help="how many directions")
    parser.add_argument(
        "--seed", type=int, required=True, metavar="S", help="the same seed gives the same draws"
    )
    parser.add_argument(
        "--extrapolate",
        action="store_true",
        help="also for an incidence that was not measured, from the nearest",
    )
    parser.add_argument("--out", metavar="FILE", help="write the draws, by the name's end as .npz or .csv")
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    import numpy as np

    from fitter.cli.numerics import start_numerics
    from fitter.cli.results import load_result
    from fitter.directions import vector_from_spherical

    out = _checked(given)
    wi = vector_from_spherical(np.deg2rad(given.theta_i), np.deg2rad(given.phi_i))
    start_numerics(screen)
    if given.model is not None:
        model = load_result(given.model).model
        drawn = model.sample(wi, given.count, seed=given.seed)
        channels, origin = model.channels, {"model": model.spec.name, "path": given.model}
    else:
        from fitter.sampling import TableSampler

        opened = reading.open_table(given.table, reading.reading_options(given))
        drawn = TableSampler(opened.table).sample(
            wi, given.count, seed=given.seed, allow_extrapolated=given.extrapolate
        )
        channels = tuple(channel.name for channel in opened.table.channels)
        origin = {"table": opened.table.metadata.name, "path": given.table}
    albedo = drawn.weight.mean(axis=0)
    document: dict[str, Any] = {
        "kind": "brdf-fitter/samples",
        "of": origin,
        "theta_i_deg": given.theta_i,
        "phi_i_deg": given.phi_i,
        "n": len(drawn),
        "seed": given.seed,
        "acceptance": drawn.acceptance,
        "valid": int(drawn.valid.sum()),
        "channels": list(channels),
        "albedo_estimate": albedo.tolist(),
    }
    if out is not None:
        _write(drawn, channels, out)
        document["path"] = str(out)
    else:
        document["samples"] = {
            "wo": drawn.wo, "pdf": drawn.pdf, "weight": drawn.weight, "valid": drawn.valid,
            "is_delta": drawn.is_delta,
        }  # fmt: skip

    def show(screen: Screen) -> None:
        estimate = ", ".join(
            f"{name} {number(float(a), 4)}" for name, a in zip(channels, albedo, strict=True)
        )
        fields = {
            "drawn": f"{len(drawn):,} directions, {int(drawn.valid.sum()):,} above the horizon",
            "acceptance": number(drawn.acceptance, 4),
            "mean weight": f"{estimate} (estimates the albedo)",
        }
        screen.fields({**fields, "written": str(out)} if out is not None else fields)

    return Outcome(document, show)


def _checked(given: argparse.Namespace) -> Path | None:
    """The output file of a call that makes sense. Raises SpecError."""
    if (given.table is None) == (given.model is None):
        raise SpecError(
            "give a TABLE or --model RESULT.json, one of them", code="bad-call", parameter="table"
        )
    if not 0 <= given.theta_i < 90:
        raise SpecError(
            f"--theta-i is {given.theta_i:g}", code="bad-call", parameter="theta_i",
            remedy="give degrees from the normal, at least 0 and below 90",
        )  # fmt: skip
    if not -360 <= given.phi_i <= 360:
        raise SpecError(
            f"--phi-i is {given.phi_i:g}",
            code="bad-call",
            parameter="phi_i",
            remedy="give degrees, -360 to 360",
        )
    if not 0 <= given.seed < 2**63:
        raise SpecError(
            f"--seed is {given.seed}", code="bad-call", parameter="seed", remedy="give 0 to 2^63 - 1"
        )
    if given.out is None:
        if given.json and given.count > MOST_PRINTED:
            raise SpecError(
                f"{given.count:,} draws are too many to print", code="bad-call", parameter="count",
                remedy=f"write them with --out FILE.npz, or ask for at most {MOST_PRINTED:,}",
            )  # fmt: skip
        return None
    out = output_file(given.out)
    if out.suffix not in (".npz", ".csv"):
        raise SpecError(
            f"draws can't be written as {out.suffix or out.name!r}", code="bad-call", parameter="out",
            remedy="end the name in .npz or .csv",
        )  # fmt: skip
    return out


def _write(drawn: Samples, channels: tuple[str, ...], path: Path) -> None:
    import numpy as np

    from fitter.documents import write_bytes

    if path.suffix == ".npz":
        binary = io.BytesIO()
        np.savez(
            binary, wo=drawn.wo, pdf=drawn.pdf, weight=drawn.weight, valid=drawn.valid,
            is_delta=drawn.is_delta, acceptance=drawn.acceptance, channels=np.array(channels),
        )  # fmt: skip
        write_bytes(binary.getvalue(), path)
        return
    names = ["wo_x", "wo_y", "wo_z", "pdf", *(f"weight_{name}" for name in channels), "valid", "is_delta"]
    rows = np.column_stack([drawn.wo, drawn.pdf, drawn.weight, drawn.valid, drawn.is_delta])
    text = io.StringIO()
    formats = ["%.17g"] * (rows.shape[1] - 2) + ["%d", "%d"]
    np.savetxt(text, rows, fmt=formats, delimiter=",", header=",".join(names), comments="")
    write_bytes(text.getvalue().encode(), path)


VERB = Verb("draw scattered directions from a raw table or a fitted model", configure, run)
