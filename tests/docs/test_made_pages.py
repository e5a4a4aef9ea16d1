"""Drawings and the HTTP reference are what their generators make."""

from __future__ import annotations

import json
import re
from pathlib import Path

from tests.docs import drawings, http_page

TEXT = re.compile(r"<text[^>]*>([^<]*)</text>")


def test_the_drawings_are_what_their_program_draws(tmp_path: Path) -> None:
    """Labels and number of lines; coordinates may differ in their last digit on another machine."""
    drawings.make(tmp_path)
    assert {path.name for path in drawings.FOLDER.iterdir()} == {path.name for path in tmp_path.iterdir()}
    for made in tmp_path.iterdir():
        committed = (drawings.FOLDER / made.name).read_text()
        drawn = made.read_text()
        assert TEXT.findall(committed) == TEXT.findall(drawn), "run python -m tests.docs.drawings"
        assert committed.count("<path") == drawn.count("<path"), "run python -m tests.docs.drawings"
        assert len(TEXT.findall(drawn)) >= 5


def test_every_drawing_is_shown() -> None:
    page = (drawings.FOLDER.parent / "conventions.md").read_text()
    assert re.findall(r"\(drawings/([\w-]+)\.svg\)", page) == list(drawings.DRAWINGS)


def test_the_http_reference_says_what_the_interface_says() -> None:
    interface = json.loads(http_page.INTERFACE.read_text())
    text = http_page.PAGE.read_text()
    assert text == http_page.page(interface), "run python -m tests.docs.http_page"
    operations = sum(len(verbs) for verbs in interface["paths"].values())
    assert len(re.findall(r"^### `[A-Z]+ /", text, re.MULTILINE)) == operations > 50
