"""``brdf-fitter scene``: render a scene of shapes, lights and measured or fitted materials."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.values import duration, grid, output_file, output_folder, share
from fitter.cli.verb import Outcome, Verb
from fitter.errors import SpecError

if TYPE_CHECKING:
    from fitter.scene import Picture


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "action", choices=("plan", "render", "compare", "example"),
        help="plan: say which effects can be left out; render the scene; compare a table with a fit in it; "
        "example: write a scene to start from",
    )  # fmt: skip
    parser.add_argument("scene", nargs="?", metavar="SCENE", help="a TOML or JSON file, see docs/scenes.md")
    parser.add_argument(
        "--out", metavar="PATH",
        help="a folder for plan.json, picture.exr, .png and .json, or compare.png; example: write this file",
    )  # fmt: skip
    parser.add_argument("--samples", type=int, metavar="N", help="stop at so many a pixel (default: 16)")
    parser.add_argument("--seconds", type=duration, metavar="TIME", help="stop after this, as 30s or 5min")
    parser.add_argument(
        "--target-error", type=share, metavar="E",
        help="stop when the root mean square of the standard errors, over the reference radiance, is this",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of all that is drawn (default: 0)")
    parser.add_argument(
        "--precision", choices=("float32", "float64", "auto"), default="float32",
        help="of the kernels; auto: what a plan finds to do",
    )  # fmt: skip
    parser.add_argument(
        "--tolerance", type=share, metavar="E", help="of the plan, as 1%% (default: the scene's)"
    )
    parser.add_argument(
        "--tiles", type=grid, default=(1, 1), metavar="CxR",
        help="of the plan: columns and rows of tiles, as 8x6; up to three programs are made for them",
    )  # fmt: skip
    parser.add_argument("--plan", action="store_true", help="render: plan first, and leave out what it says")
    parser.add_argument(
        "--layers", action="store_true", help="render: one layer in the OpenEXR file for each effect"
    )
    parser.add_argument(
        "--material", metavar="NAME", help="compare: the material of the scene that both are put in place of"
    )
    parser.add_argument("--table", metavar="TABLE", help="compare: the measured table")
    parser.add_argument("--fit", metavar="RESULT.json", help="compare: the fit")
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    if given.action == "example":
        return _example(given.out)
    if given.scene is None:
        raise SpecError(
            f"`scene {given.action}` needs a scene", code="bad-call", parameter="scene",
            remedy="name a file; `brdf-fitter scene example --out scene.toml` writes one to start from",
        )  # fmt: skip
    return {"plan": _plan, "render": _render, "compare": _compare}[given.action](given, screen)


def _example(out: str | None) -> Outcome:
    from fitter.documents import write_bytes
    from fitter.scene.example import EXAMPLE

    path = None if out is None else output_file(out)
    if path is not None:
        write_bytes(EXAMPLE.encode(), path)

    def show(screen: Screen) -> None:
        screen.line(EXAMPLE.rstrip() if path is None else f"written: {path}")

    document = {"kind": "brdf-fitter/scene-example", "scene": EXAMPLE, "path": path and str(path)}
    return Outcome(document, show)


def _render(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics

    out = None if given.out is None else output_folder(given.out)
    start_numerics(screen)
    from fitter.scene import load_scene, plan, render
    from fitter.scene.layers import layers
    from fitter.scene.picture import save

    scene = load_scene(given.scene)
    planned = None
    if given.plan:
        with screen.progress("plan") as progress:
            planned = plan(scene, progress=progress, **_of_plan(given))
    with screen.progress("render") as progress:
        picture = render(scene, by=planned, progress=progress, **_limits(given))
    if given.layers:
        with screen.progress("layers") as progress:
            picture.layers.update(layers(scene, picture, progress))
    written = [] if out is None else save(picture, out)

    def show(screen: Screen) -> None:
        if picture.plan is not None:
            show_plan(picture.plan, screen)
        show_picture(picture, screen)
        if written:
            screen.line(f"written: {', '.join(map(str, written))}")

    return Outcome({**picture.to_dict(), "paths": [str(path) for path in written]}, show)


def _of_plan(given: argparse.Namespace) -> dict[str, Any]:
    return {
        "tolerance": given.tolerance, "seed": given.seed, "precision": given.precision, "tiles": given.tiles,
    }  # fmt: skip


def _limits(given: argparse.Namespace) -> dict[str, Any]:
    return {
        "samples": given.samples, "seconds": given.seconds, "target_error": given.target_error,
        "seed": given.seed, "precision": given.precision,
    }  # fmt: skip


def _plan(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics
    from fitter.documents import write_document

    out = None if given.out is None else output_folder(given.out)
    start_numerics(screen)
    from fitter.scene import load_scene, plan

    scene = load_scene(given.scene)
    with screen.progress("plan") as progress:
        document = dict(plan(scene, progress=progress, **_of_plan(given)).document)
    if out is not None:
        write_document(document, out / "plan.json")

    def show(screen: Screen) -> None:
        show_plan(document, screen)
        if out is not None:
            screen.line(f"written: {out / 'plan.json'}")

    return Outcome(document, show)


def show_plan(document: Mapping[str, Any], screen: Screen) -> None:
    """Each decision with its sentence, the joint bound, and what is saved."""
    rows = [
        [one["effect"], one["subject"], "off" if one["off"] else "on", one["state"], one["sentence"]]
        for one in document["decisions"]
    ]
    screen.table(("effect", "of", "", "", "why"), rows)
    _show_programs(document["programs"], screen)
    operations = document["operations"]
    bound, estimated, tolerance = (100 * document[name] for name in ("bound", "estimated", "tolerance"))
    more = f" as proved, and {estimated:.2g} % as estimated" if estimated else ""
    screen.line(
        f"together at most {bound:.2g} % off{more} (tolerance {tolerance:.2g} %, of max(L, 0.01 F), "
        f"F = {document['reference']:.4g})"
    )
    screen.line(
        f"{operations['planned']:,.0f} operations a sample of a pixel for {operations['all']:,.0f}: "
        f"{operations['saved']:.3g} times fewer"
    )
    seconds = document["seconds"]
    screen.line(
        f"planned in {seconds['planning']:.2g} s, beside {sum(seconds.values()) - seconds['planning']:.2g} s "
        f"of pre-pass and counting, of which {seconds['compile']:.2g} s of compiling"
    )


def _show_programs(programs: Sequence[Mapping[str, Any]], screen: Screen) -> None:
    """What each tile's program leaves out, where there are several."""
    total = sum(one["pixels"] for one in programs)
    rows = [
        [
            str(len(one["tiles"])), f"{100 * one['pixels'] / total:.0f} %",
            ", ".join(f"{d['effect']} of {d['subject']}" for d in one["decisions"] if d["off"]) or "-",
            f"{one['operations']['planned']:,.0f}",
        ]
        for one in programs
    ]  # fmt: skip
    if rows:
        screen.table(("tiles", "of the picture", "left out there", "operations"), rows)


def _compare(given: argparse.Namespace, screen: Screen) -> Outcome:

    from fitter.cli.numerics import start_numerics

    for name in ("material", "table", "fit"):
        if getattr(given, name) is None:
            raise SpecError(f"compare needs --{name}", code="bad-call", parameter=name)
    out = None if given.out is None else output_folder(given.out)
    opened = reading.open_table(given.table, reading.reading_options(given))
    start_numerics(screen)
    from fitter.cli.results import load_result
    from fitter.scene import load_scene
    from fitter.scene.comparison import compare

    scene = load_scene(given.scene)
    model = load_result(given.fit).model
    with screen.progress("compare") as progress:
        found = compare(scene, given.material, opened.table, model, progress=progress, **_limits(given))
    written = [] if out is None else found.save(out)

    def show(screen: Screen) -> None:
        screen.table(("channel", "radiance error", "of it noise", "bias", "PSNR (dB)"), found.rows())
        screen.line(found.sentence())
        if written:
            screen.line(f"written: {', '.join(map(str, written))}")

    return Outcome({**found.to_dict(), "paths": [str(path) for path in written]}, show)


def show_picture(picture: Picture, screen: Screen) -> None:
    """What was rendered, how good it is, and error against time."""
    height, width, _ = picture.radiance.shape
    screen.fields(
        {
            "picture": f"{width} x {height}, {', '.join(picture.channels)}, {picture.precision}",
            "samples": f"{picture.samples} a pixel in {picture.seconds:.1f} s (by: {picture.stopped}), "
            f"{picture.compile_seconds:.1f} s of them compiling",
            "error": f"{number(picture.error, 3)} (rms of the standard errors over F)",
            "F": f"{number(picture.reference, 4)} W/(m2 sr), mean of the clipped radiance of shapes",
        }
    )
    rows = [[str(n), f"{t:.2f}", number(e, 3)] for n, t, e in picture.history]
    screen.table(("samples", "seconds", "error"), rows)
    for note in picture.notes:
        screen.line(f"note: {note}")


VERB = Verb(
    "plan and render a scene of shapes, lights and materials, compare a table with a fit", configure, run
)
