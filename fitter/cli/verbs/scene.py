"""``brdf-fitter scene``: render a scene of shapes, lights and measured or fitted materials."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from fitter.cli.screen import Screen, number
from fitter.cli.values import duration, output_file, output_folder, share
from fitter.cli.verb import Outcome, Verb
from fitter.errors import SpecError

if TYPE_CHECKING:
    from fitter.scene import Picture


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "action", choices=("render", "example"),
        help="render the scene; example: write one to start from",
    )  # fmt: skip
    parser.add_argument("scene", nargs="?", metavar="SCENE", help="a TOML or JSON file, see docs/scenes.md")
    parser.add_argument(
        "--out", metavar="PATH",
        help="render: write picture.exr, .png and .json into this folder; example: write this file",
    )  # fmt: skip
    parser.add_argument("--samples", type=int, metavar="N", help="stop at so many a pixel (default: 16)")
    parser.add_argument("--seconds", type=duration, metavar="TIME", help="stop after this, as 30s or 5min")
    parser.add_argument(
        "--target-error", type=share, metavar="E",
        help="stop when the root mean square of the standard errors, over the reference radiance, is this",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of all that is drawn (default: 0)")
    parser.add_argument(
        "--precision", choices=("float32", "float64"), default="float32", help="of the kernels"
    )


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    if given.action == "example":
        return _example(given.out)
    if given.scene is None:
        raise SpecError(
            f"`scene {given.action}` needs a scene", code="bad-call", parameter="scene",
            remedy="name a file; `brdf-fitter scene example --out scene.toml` writes one to start from",
        )  # fmt: skip
    return _render(given, screen)


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
    from fitter.scene import load_scene, render
    from fitter.scene.picture import save

    scene = load_scene(given.scene)
    with screen.progress("render") as progress:
        picture = render(
            scene, samples=given.samples, seconds=given.seconds, target_error=given.target_error,
            seed=given.seed, precision=given.precision, progress=progress,
        )  # fmt: skip
    written = [] if out is None else save(picture, out)

    def show(screen: Screen) -> None:
        show_picture(picture, screen)
        if written:
            screen.line(f"written: {', '.join(map(str, written))}")

    return Outcome({**picture.to_dict(), "paths": [str(path) for path in written]}, show)


def show_picture(picture: Picture, screen: Screen) -> None:
    """What was rendered, how good it is, and error against time."""
    height, width, _ = picture.radiance.shape
    screen.fields(
        {
            "picture": f"{width} x {height}, {', '.join(picture.channels)}, {picture.precision}",
            "samples": f"{picture.samples} a pixel in {picture.seconds:.1f} s (by: {picture.stopped})",
            "error": f"{number(picture.error, 3)} (rms of the standard errors over F)",
            "F": f"{number(picture.reference, 4)} W/(m2 sr), mean of the clipped radiance of shapes",
        }
    )
    rows = [[str(n), f"{t:.2f}", number(e, 3)] for n, t, e in picture.history]
    screen.table(("samples", "seconds", "error"), rows)
    for note in picture.notes:
        screen.line(f"note: {note}")


VERB = Verb("render a scene of shapes, lights and materials", configure, run)
