"""The page: escaped, self-contained, accessible."""

from __future__ import annotations

import base64
import html
import re
import threading
from html.parser import HTMLParser

import pytest

from fitter.quality import check
from fitter.report import Report, build
from fitter.report.figures import plain
from fitter.report.paper import Paper
from tests.report.conftest import MakeFit, MakePosterior, MakeTable, strict

NASTY = '<script>alert("x")</script>'


class _Elements(HTMLParser):
    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page(make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior) -> str:
    table = make_table((NASTY, "G", "B"), name=NASTY, masked={}, notes=(NASTY,), provenance={NASTY: NASTY})
    fit = make_fit(table, message=NASTY, warnings=(NASTY,), status="not_converged")
    return build(table, fit, make_posterior(fit, message=NASTY, warnings=(NASTY,))).html()


def test_names_of_strangers_are_escaped(page: str) -> None:
    assert "<script" not in page.lower()
    assert page.count("&lt;script&gt;") > 10


def test_every_element_is_closed(page: str) -> None:
    assert _Elements(page).open == []


def test_nothing_is_fetched(page: str) -> None:
    for tag, attributes in _Elements(page).found:
        assert tag not in ("script", "link", "iframe", "object", "embed", "base")
        for name, value in attributes.items():
            assert not name.startswith("on")
            if name in ("src", "srcset", "poster", "data", "action"):
                assert (value or "").startswith(("data:image/svg+xml;base64,", "data:image/png;base64,"))
            if name == "href":
                assert (value or "").startswith("#")
    assert "@import" not in page
    assert "url(" not in page
    without_data = re.sub(r"base64,[A-Za-z0-9+/=]+", "", page)
    assert "http://" not in without_data
    assert "https://" not in without_data


def test_figures_fetch_nothing(page: str) -> None:
    pictures = re.findall(r"svg\+xml;base64,([A-Za-z0-9+/=]+)", page)
    assert len(pictures) >= 15
    for picture in pictures:
        svg = base64.b64decode(picture).decode("utf-8")
        for link in re.findall(r'href="([^"]*)"', svg):
            assert link.startswith(("#", "data:"))
        assert "<script" not in svg


def test_every_figure_has_words_and_every_link_a_target(page: str) -> None:
    found = _Elements(page).found
    assert all(attributes.get("alt") for tag, attributes in found if tag == "img")
    identifiers = {attributes.get("id") for _, attributes in found}
    links = [attributes["href"] or "" for tag, attributes in found if tag == "a"]
    assert len(links) >= 9
    assert all(link.removeprefix("#") in identifiers for link in links)


def test_the_words_of_gum(page: str) -> None:
    for words in (
        "standard uncertainty u", "expanded uncertainty U = k u", "credible",
        "it is not a constant of the material",
    ):  # fmt: skip
        assert words in page


def test_pyplot_keeps_no_figure_and_threads_do_not_mind(make_table: MakeTable, make_fit: MakeFit) -> None:
    from matplotlib import pyplot

    table = make_table(("value",), in_plane=True)
    report = build(table, make_fit(table))
    pages: list[str] = []
    threads = [threading.Thread(target=lambda: pages.append(report.html())) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(pages) == 2
    assert pyplot.get_fignums() == []


def test_figure_text_is_plain() -> None:
    assert plain("$x$") == r"\$x\$"
    assert plain("漢\n字") == "???"
    assert len(plain("a" * 100)) == 60


def test_the_quality_of_the_table_is_shown(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table()
    report = build(table, make_fit(table))
    findings = report.record["quality"]["findings"]
    assert [finding["name"] for finding in findings] == [finding.name for finding in check(table).findings]
    page = html.unescape(report.html())
    assert all(finding["sentence"] in page for finding in findings)
    # A record of before there was such a section is still drawn.
    older = {name: part for name, part in report.record.items() if name != "quality"}
    assert 'id="quality"' not in Report.from_dict(older).html()


@pytest.mark.long
def test_the_pdf_shows_the_record_and_is_the_same_each_time(
    make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior
) -> None:
    table = make_table((NASTY,), name=NASTY, notes=(NASTY * 40, "λ → ☃"), scale_uncertainty=0.01)
    fit = make_fit(table, message=NASTY, warnings=("w" * 500,))
    report = build(table, fit, make_posterior(fit), others=[fit])
    first = report.pdf()
    assert first == Report.from_dict(strict(report)).pdf()
    assert first.startswith(b"%PDF-")
    assert first.count(b"/Type /Page\n") + first.count(b"/Type /Page ") >= 4


def test_paper_breaks_pages_and_repeats_the_head_of_a_table() -> None:
    paper = Paper("title", "footer")
    paper.heading("heading")
    paper.table(["name", "number"], [[f"row {k}", str(k)] for k in range(150)])
    paper.text("word " * 2000)
    pages = paper.pages
    written = [[text.get_text() for text in page.texts] for page in pages]
    assert len(pages) >= 4
    assert sum("name" in page for page in written) == 3
    assert sorted(int(t) for page in written for t in page if t.isdigit()) == list(range(150))
    assert sum(t.count("word") for page in written for t in page) == 2000
    lowest = min(text.get_position()[1] for page in pages for text in page.texts)
    assert lowest > 0.75 / 11.69 - 0.02
