"""A browser that tests drive: Chromium as the system has it, through Playwright."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, Locator, Page, expect, sync_playwright

#: Set where there has to be a browser, to its path: its tests don't skip then.
VARIABLE = "BRDF_CHROMIUM"
#: A laptop's and a phone's windows.
LAPTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
#: WebGL in software, since test machines have no GPU.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def chromium() -> str:
    """The browser's path. Skips the test where there is none and none is asked for."""
    asked = os.environ.get(VARIABLE)
    found = shutil.which(asked or "chromium")
    if asked:
        assert found is not None, f"{VARIABLE}={asked} is not there"
    if found is None:
        pytest.skip(f"NO CHROMIUM: apt-get install chromium, or set {VARIABLE}")
    return found


@contextmanager
def opened() -> Iterator[Browser]:
    path = chromium()
    expect.set_options(timeout=60_000)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield browser
        browser.close()


@dataclass
class Watched:
    """A page, and what it must not do: complain, or ask other hosts for anything."""

    page: Page
    host: str
    complaints: list[str] = field(default_factory=list[str])
    strangers: list[str] = field(default_factory=list[str])

    @classmethod
    def of(cls, context: BrowserContext, address: str) -> Watched:
        watched = cls(context.new_page(), urlsplit(address).netloc)
        page = watched.page
        page.set_default_timeout(60_000)
        page.on("console", watched._said)
        page.on("pageerror", lambda error: watched.complaints.append(str(error)))
        page.on("request", lambda request: watched._asked(request.url))
        return watched

    def _said(self, message: Any) -> None:
        if message.type == "error":
            self.complaints.append(f"{message.text} ({message.location})")

    def _asked(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("data", "blob") and parts.netloc != self.host:
            self.strangers.append(url)

    def check(self) -> None:
        """No complaint so far, and no request to a stranger."""
        assert not self.complaints, self.complaints
        assert not self.strangers, self.strangers

    def accessible(self, where: str) -> None:
        """No serious or critical finding of axe-core."""
        # Not through a <script> element, which the page's policy would refuse.
        self.page.evaluate(_axe())
        found: Any = self.page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        bad = [
            (one["id"], one["impact"], one["help"], [node["html"][:150] for node in one["nodes"][:3]])
            for one in found["violations"] if one["impact"] in ("serious", "critical")
        ]  # fmt: skip
        assert not bad, (where, bad)

    def fits_in_width(self, where: str) -> None:
        """Nothing sticks out of the window."""
        wide, window = self.page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
        assert wide <= window, (where, wide, window)


def drawn(figure: Locator) -> None:
    """Wait until a plot is there and has traces."""
    expect(figure).to_have_attribute("data-drawn", re.compile(r"\d+"), timeout=120_000)
    expect(figure.locator("svg, canvas").first).to_be_attached()


def open_panel(page: Page, name: str) -> None:
    page.get_by_role("navigation").get_by_role("link", name=name).click()


def _axe() -> str:
    found = find_spec("axe_playwright_python")
    assert found is not None
    assert found.submodule_search_locations
    return (Path(found.submodule_search_locations[0]) / "axe.min.js").read_text()
