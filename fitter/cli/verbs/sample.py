"""``brdf-fitter sample``: draw scattered directions from a raw table or from a fitted model."""

from __future__ import annotations

import argparse
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
    parser.add_argument(
        "--theta-i", type=float, nargs="+", metavar="DEG",
        help="incident polar angle, or several; with --pairs incidences are drawn, too",
    )  # fmt: skip
    parser.add_argument(
        "--phi-i", type=float, default=0.0, metavar="DEG", help="incident azimuth (default: 0)"
    )
    parser.add_argument("-n", "--count", type=int, required=True, metavar="N", help="how many directions")
    parser.add_argument(
        "--seed", type=int, required=True, metavar="S", help="the same seed gives the same draws"
    )
    parser.add_argument(
        "--pairs", action="store_true",
        help="pairs of directions from a TABLE, by f_r cos(theta_i) cos(theta_o)",
    )  # fmt: skip
    parser.add_argument(
        "--weights", type=float, nargs="+", metavar="W",
        help="of a TABLE's channels (default: equal)",
    )  # fmt: skip
    parser.add_argument(
        "--method", choices=("rejection", "inversion"),
        help="how a TABLE is drawn from (default: whichever is faster); both are exact",
    )  # fmt: skip
    parser.add_argument(
        "--max-evaluations", type=int, metavar="N", help="candidates to try at most, of a TABLE"
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

    out = checked(given)
    wi = vector_from_spherical(np.deg2rad(given.theta_i or []), np.deg2rad(given.phi_i))
    start_numerics(screen)
    slices: list[dict[str, Any]] | None = None
    if given.model is not None:
        model = load_result(given.model).model
        drawn = model.sample(wi[0], given.count, seed=given.seed)
        channels, origin = model.channels, {"model": model.spec.name, "path": given.model}
    else:
        from fitter.sampling import TableSampler

        opened = reading.open_table(given.table, reading.reading_options(given))
        sampler = TableSampler(opened.table, weights=given.weights, method=given.method)
        if given.pairs:
            drawn = sampler.sample_pairs(given.count, given.seed, max_evaluations=given.max_evaluations)
        else:
            drawn = sampler.sample(
                wi if len(wi) > 1 else wi[0], given.count, given.seed, allow_extrapolated=given.extrapolate,
                max_evaluations=given.max_evaluations,
            )  # fmt: skip
            slices = sampler.slices(wi, allow_extrapolated=given.extrapolate)
        channels = tuple(channel.name for channel in opened.table.channels)
        origin = {"table": opened.table.metadata.name, "path": given.table}
    return outcome(given, drawn, channels, origin, slices, out)


def outcome(
    given: argparse.Namespace, drawn: Samples, channels: Sequence[str], origin: Mapping[str, Any],
    slices: Sequence[Mapping[str, Any]] | None, out: Path | None,
) -> Outcome:
    """The draws in words and as a document, and in the file ``out``."""
    from fitter.sampling import moment

    angles: list[float] = given.theta_i or []
    found = [moment(part) for part in _by_incidence(drawn, max(len(angles), 1))]
    document: dict[str, Any] = {
        "kind": "brdf-fitter/samples",
        "of": origin,
        "theta_i_deg": angles[0] if len(angles) == 1 else angles,
        "phi_i_deg": given.phi_i,
        "pairs": given.pairs,
        "n": len(drawn),
        "seed": given.seed,
        "acceptance": drawn.acceptance,
        "evaluations": drawn.evaluations,
        "valid": int(drawn.valid.sum()),
        "slices": slices,
        "channels": list(channels),
        "albedo_estimate": _one_or_all([one.value.tolist() for one in found]),
        "albedo_standard_error": _one_or_all([_finite(one.standard_error) for one in found]),
    }
    if out is not None:
        _write(drawn, channels, out)
        document["path"] = str(out)
    else:
        document["samples"] = {
            "wo": drawn.wo, "pdf": drawn.pdf, "weight": drawn.weight, "valid": drawn.valid,
            "is_delta": drawn.is_delta, **({} if drawn.wi is None else {"wi": drawn.wi}),
        }  # fmt: skip

    def show(screen: Screen) -> None:
        fields = {
            "drawn": f"{len(drawn):,} directions, {int(drawn.valid.sum()):,} above the horizon",
            "acceptance": number(drawn.acceptance, 4),
        }
        for k, one in enumerate(found):
            where = f", theta_i {angles[k]:g}" if len(angles) > 1 else ""
            estimate = ", ".join(
                f"{name} {number(float(a), 4)} +- {float(e):.1g}"
                for name, a, e in zip(channels, one.value, one.standard_error, strict=True)
            )
            of = "f_r cos cos over both hemispheres" if given.pairs else "the albedo"
            fields[f"mean weight{where}"] = f"{estimate} (estimates {of})"
            if slices is not None:
                share = 100 * slices[k]["energy_error"]
                fields[f"interpolation{where}"] = f"makes {share:.2g} % of that uncertain"
        screen.fields({**fields, "written": str(out)} if out is not None else fields)

    return Outcome(document, show)


def _by_incidence(drawn: Samples, count: int) -> list[Samples]:
    """The draws of each of ``count`` incidences, which have as many each."""
    if count == 1:
        return [drawn]
    n = len(drawn) // count
    names = ("wo", "pdf", "weight", "valid", "is_delta")
    return [
        replace(drawn, **{name: getattr(drawn, name)[k * n : (k + 1) * n] for name in names})
        for k in range(count)
    ]


def _one_or_all(values: list[Any]) -> Any:
    return values[0] if len(values) == 1 else values


def _finite(errors: Any) -> list[float | None]:
    """Of one draw nobody knows the spread: null."""
    return [None if e == float("inf") else float(e) for e in errors]


def checked(given: argparse.Namespace) -> Path | None:
    """The output file of a call that makes sense. Raises SpecError."""
    if (given.table is None) == (given.model is None):
        raise SpecError(
            "give a TABLE or --model RESULT.json, one of them", code="bad-call", parameter="table"
        )
    angles: list[float] = given.theta_i or []
    if bool(angles) == given.pairs:
        raise SpecError(
            "give --theta-i DEG, or --pairs to have incidences drawn, too", code="bad-call",
            parameter="theta_i",
        )  # fmt: skip
    for angle in angles:
        if not 0 <= angle < 90:
            raise SpecError(
                f"--theta-i is {angle:g}", code="bad-call", parameter="theta_i",
                remedy="give degrees from the normal, at least 0 and below 90",
            )  # fmt: skip
    for name, value in (
        ("pairs", given.pairs), ("weights", given.weights), ("method", given.method),
        ("max_evaluations", given.max_evaluations), ("theta_i", len(angles) > 1),
    ):  # fmt: skip
        if given.model is not None and value:
            raise SpecError(
                f"--{name.replace('_', '-')} is for tables, not for models" if name != "theta_i" else
                "a model is drawn from for one incidence", code="bad-call", parameter=name,
                remedy="leave it out, or give a TABLE",
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
        draws = given.count * max(len(angles), 1)
        if given.json and draws > MOST_PRINTED:
            raise SpecError(
                f"{draws:,} draws are too many to print", code="bad-call", parameter="count",
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


def _write(drawn: Samples, channels: Sequence[str], path: Path) -> None:
    import numpy as np

    from fitter.documents import write_bytes

    if path.suffix == ".npz":
        binary = io.BytesIO()
        also: dict[str, Any] = {} if drawn.wi is None else {"wi": drawn.wi}
        np.savez(
            binary, wo=drawn.wo, pdf=drawn.pdf, weight=drawn.weight, valid=drawn.valid,
            is_delta=drawn.is_delta, acceptance=drawn.acceptance, channels=np.array(channels), **also,
        )  # fmt: skip
        write_bytes(binary.getvalue(), path)
        return
    names = ["wo_x", "wo_y", "wo_z", "pdf", *(f"weight_{name}" for name in channels), "valid", "is_delta"]
    columns = [drawn.wo, drawn.pdf, drawn.weight, drawn.valid, drawn.is_delta]
    if drawn.wi is not None:
        names, columns = ["wi_x", "wi_y", "wi_z", *names], [drawn.wi, *columns]
    rows = np.column_stack(columns)
    text = io.StringIO()
    formats = ["%.17g"] * (rows.shape[1] - 2) + ["%d", "%d"]
    np.savetxt(text, rows, fmt=formats, delimiter=",", header=",".join(names), comments="")
    write_bytes(text.getvalue().encode(), path)


VERB = Verb("draw scattered directions from a raw table or a fitted model", configure, run)
