"""Makes docs/picture.png, the README's: ``python -m tests.docs.picture`` (needs Chromium).

Two slices out of a report of the bundled paint, as Chromium shows them.
"""

from __future__ import annotations

from pathlib import Path

import fitter
from fitter import datasets, report
from fitter.report.figures import slice_pictures
from tests.api.browser import opened

FILE = Path(__file__).resolve().parents[2] / "docs" / "picture.png"
SHOWN = ("at 30 degrees", "at 60 degrees")


def make(file: Path) -> None:
    table = fitter.load(datasets.sample("glossy_paint"))
    made = report.complete(table, fitter.fit(table, "torrance_sparrow"))
    pictures = [one for one in slice_pictures(made.record) if any(words in one.alt for words in SHOWN)]
    assert len(pictures) == len(SHOWN)
    images = "".join(f'<img width="620" src="{one.uri}">' for one in pictures)
    with opened() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 100})
        page.set_content(f'<body style="margin:8px;background:white;white-space:nowrap">{images}</body>')
        page.screenshot(path=file, full_page=True)


if __name__ == "__main__":
    make(FILE)
