"""Look development: a measured paint as materials for renderers, and a picture of what was lost on the way.

    python examples/look.py [TABLE] [--model torrance_sparrow] [--out look]

Each export says how far it is from the table; compare.png shows the table, the fit and four times their
difference on a ball. Other targets: `brdf-fitter export --help`.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path

import fitter
from fitter import datasets, export, scene

TARGETS = {"gltf": "paint.gltf", "openpbr": "paint.mtlx", "glsl": "paint.glsl"}

BALL = """
channels = ["R", "G", "B"]
camera = { position = [0.0, -4.0, 1.2], look_at = [0.0, 0.0, 0.0], fov_deg = 18, width = 64, height = 64 }
materials = { paint = { model = "lambert", values = { kd = 0.5 } } }
shapes = [{ kind = "sphere", material = "paint", center = [0.0, 0.0, 0.0], radius = 0.6 }]
lights = [{ kind = "directional", direction = [0.6, -1.0, 1.2], irradiance = 3.0 }]
"""


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?", default=datasets.sample("glossy_paint"))
    parser.add_argument("--model", default="torrance_sparrow")
    parser.add_argument("--out", type=Path, default=Path("look"))
    given = parser.parse_args(words)

    table = fitter.load(given.table)
    fit = fitter.fit(table, given.model)
    print(f"{given.model}: {fit.status}, relative rmse {fit.metrics['relative_rmse']:.3f}")

    given.out.mkdir(parents=True, exist_ok=True)
    for target, name in TARGETS.items():
        written = export.write(fit, target, given.out / name)
        print(f"{written.path}: {written.convention}")
        for note in written.notes:
            print(f"  {note.code}: {note.message}")

    # The example's material is replaced by the table, then by the fit.
    ball = scene.scene(tomllib.loads(BALL))
    compared = scene.compare(ball, "paint", table, fit.model, samples=4, seed=1)
    compared.save(given.out)
    print(f"{given.out / 'compare.png'}: {compared.sentence()}")


if __name__ == "__main__":
    main()
