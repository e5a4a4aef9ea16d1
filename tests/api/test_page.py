"""The page in a real browser: a measurement is uploaded, corrected, looked at, fitted, rendered and taken."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page, Route, expect

import fitter
from api import keys
from fitter import datasets

from .browser import LAPTOP, PHONE, Watched, opened
from .conftest import listening, small_table

MODELS = ["ward", "torrance_sparrow", "lafortune", "oren_nayar"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with opened() as found:
        yield found


@pytest.fixture
def watch(browser: Browser) -> Iterator[Callable[..., Watched]]:
    """Open a page: ``watch(address)``."""
    contexts: list[Any] = []

    def start(address: str, window: dict[str, int] = LAPTOP, **options: Any) -> Watched:
        contexts.append(browser.new_context(viewport=window, accept_downloads=True, **options))
        return Watched.of(contexts[-1], address)

    yield start
    for context in contexts:
        context.close()


def drawn(figure: Locator) -> None:
    """Wait until a plot is there and has traces."""
    expect(figure).to_have_attribute("data-drawn", re.compile(r"\d+"), timeout=120_000)
    expect(figure.locator("svg, canvas").first).to_be_attached()


def open_panel(page: Page, name: str) -> None:
    page.get_by_role("navigation").get_by_role("link", name=name).click()


def test_the_whole_path(
    watch: Callable[..., Watched], client: Any, address: str, tmp_path: Path
) -> None:  # fmt: skip
    watched = watch(address)
    page = watched.page
    page.goto(address)

    # Read as the file is not meant, which the check notices; corrected, and the peak moves.
    page.get_by_text("What the file can't say about itself").click()
    page.locator("details").get_by_label("Convention").select_option("phi_specular_0")
    page.set_input_files("#file", str(datasets.sample("glossy_paint")))
    expect(page.get_by_role("heading", name="glossy_paint")).to_be_visible()
    expect(page.locator(".findings .warning", has_text="convention")).to_be_visible()
    peaks = page.get_by_role("region", name=re.compile("Peaks"))
    expect(peaks.get_by_role("row", name=re.compile("^45°"))).to_contain_text("light's side")
    correction = page.locator("section", has=page.get_by_role("heading", name="Correct the reading")).last
    correction.get_by_label("Convention").select_option("phi_specular_180")
    correction.get_by_role("button", name="Read it again").click()
    row = peaks.get_by_role("row", name=re.compile("^45°"))
    expect(row).to_contain_text("specular side (was light's)")
    drawn(page.locator("#panel-table .plot"))
    expect(page.locator("#panel-table .findings li").first).to_be_visible()
    watched.accessible("measurement")
    table = re.search(r"[?&]table=(\w{32})", page.url)
    assert table is not None

    # Looked at: what is drawn is what the service says.
    open_panel(page, "Look")
    page.get_by_role("button", name="θ_i = 45°").click()
    for figure in page.locator("#panel-look .plot").all():
        drawn(figure)
    slices = page.locator("#panel-look .plot").nth(1)
    expect(slices).to_have_attribute("aria-label", re.compile("of 45°, cube root scale: R, G, B"))
    look = page.locator("#panel-look")
    look.get_by_label("Channel", exact=True).select_option("G")
    look.get_by_label("Scale of f_r").select_option("log")
    expect(slices).to_have_attribute("aria-label", re.compile("of 45°, logarithmic scale: G[.]"))
    plotted = page.evaluate("document.querySelectorAll('#panel-look .plot')[1].data[0].r")
    measured = fitter.load(datasets.sample("glossy_paint"))
    highest = max(value for value in plotted if value is not None)
    assert 10**highest == pytest.approx(_largest(measured, 45.0), rel=0.02)
    before = page.evaluate("JSON.stringify(document.querySelector('#panel-look .plot').camera)")
    page.get_by_role("button", name="turn left").click()
    assert page.evaluate("JSON.stringify(document.querySelector('#panel-look .plot').camera)") != before
    watched.accessible("look")

    # Fitted, with progress from the event stream.
    open_panel(page, "Fit")
    page.evaluate(
        "window.seen = []; new MutationObserver(() => {"
        "const bar = document.querySelector('#panel-fit .job progress'); if (bar) seen.push(bar.value);"
        "}).observe(document.getElementById('panel-fit'), {subtree: true, childList: true})"
    )
    page.get_by_role("button", name="Fit", exact=True).click()
    results = page.get_by_role("region", name=re.compile("Estimates"))
    expect(results).to_be_visible(timeout=300_000)
    shares = page.evaluate("seen")
    assert len(set(shares)) > 4, shares
    assert shares == sorted(shares)
    for model in MODELS:
        expect(results.get_by_role("columnheader", name=model)).to_be_visible()
    expect(results.get_by_role("row", name=re.compile("^alpha"))).to_contain_text("±")
    best = page.locator("input[name=focus]:checked").locator("xpath=..").inner_text().strip()
    fits = page.locator("#panel-fit .plot")
    expect(fits).to_have_count(1 + len(MODELS), timeout=120_000)
    for figure in fits.all():
        drawn(figure)
    expect(fits.first).to_have_attribute("aria-label", re.compile(f"95 % band of {best}"), timeout=300_000)
    names = fits.first.evaluate("(plot) => plot.data.map((trace) => trace.name)")
    assert set(names) == {"95 % of new measurements", "measured", *MODELS}
    page.locator("#panel-fit").get_by_label("Budget / s", exact=True).fill("4")
    page.get_by_label("Effective sample size").fill("50")
    page.get_by_role("button", name="Sample the posterior").click()
    drawn(page.locator("#panel-fit .plot.square"))
    cost = page.locator("section.card", has=page.get_by_role("heading", name="Accuracy against time")).last
    cost.get_by_label("Time limit / s").fill("3")
    cost.get_by_role("button", name="Measure it").click()
    drawn(cost.locator(".plot"))
    told = cost.get_by_text(re.compile(f"fit in focus, {best}"))
    ringed = "in focus" in cost.locator(".plot").evaluate("(plot) => plot.data.map((trace) => trace.name)")
    # In so short a time not every model has its turn; where this one had, it is ringed.
    expect(told).to_contain_text("ringed point" if ringed else "No point was measured")
    watched.accessible("fit")

    # Rendered beside the raw table.
    open_panel(page, "See")
    see = page.locator("#panel-see")
    see.get_by_label("Samples a pixel").select_option("4")
    see.get_by_label("Light", exact=True).select_option("low")
    page.get_by_role("button", name="Render").click()
    expect(page.locator("#panel-see canvas")).to_have_count(3, timeout=300_000)
    lit = page.evaluate(
        "[...document.querySelectorAll('#panel-see canvas')].map((canvas) => new Set(canvas.getContext('2d')"
        ".getImageData(0, 0, canvas.width, canvas.height).data).size)"
    )
    assert min(lit) > 20, lit
    expect(page.get_by_role("region", name="Effects")).to_contain_text("reflections between shapes off")
    watched.accessible("see")

    # Taken away: a report, an export, the commands, the calls.
    open_panel(page, "Take away")
    with page.expect_popup() as report:
        page.get_by_role("link", name="Open the report").click()
    expect(report.value.get_by_role("heading", level=1)).to_contain_text(best)
    report.value.close()
    with page.expect_download() as exported:
        page.get_by_role("button", name="Export").click()
    exported.value.save_as(tmp_path / "paint.glsl")
    assert "brdf(" in (tmp_path / "paint.glsl").read_text()
    watched.accessible("take away")
    command = page.get_by_role("region", name="commands").inner_text()
    assert all(f"--model '{model}'" in command for model in MODELS)
    _run(command.splitlines()[0], tmp_path)
    calls = page.get_by_role("region", name="calls of Look").inner_text().splitlines()
    said = subprocess.run(["sh", "-c", calls[-1]], capture_output=True, check=True).stdout
    assert b'"channels"' in said

    # The link reopens it.
    open_panel(page, "Fit")
    link = page.url
    again = watch(address)
    again.page.goto(link)
    expect(again.page.get_by_role("radio", name=best)).to_be_checked(timeout=120_000)
    drawn(again.page.locator("#panel-fit .plot.square"))
    # So do the calls that made it: they are known from the jobs, and the service takes them as they are.
    cost = again.page.locator("#panel-fit section.card", has_text="Accuracy against time")
    drawn(cost.last.locator(".plot"))
    open_panel(again.page, "See")
    expect(again.page.locator("#panel-see canvas")).to_have_count(3)
    open_panel(again.page, "Take away")
    shown = again.page.get_by_role("region", name=re.compile("^calls of (Fit|See)"))
    expect(shown).to_have_count(2)
    posts = [line for text in shown.all_inner_texts() for line in text.splitlines() if "--json" in line]
    kinds = sorted(line.rsplit("/v1/")[-1].strip("'") for line in posts)
    assert kinds == ["fits", "posteriors", "scenes/render", "scenes/render", "tradeoffs"]
    for post in posts:
        said = subprocess.run(["sh", "-c", post], capture_output=True, check=True)
        job = json.loads(said.stdout)
        assert job["state"] == "queued", (post, said)
        client.post(f"/v1/jobs/{job['id']}/cancel")
    again.check()
    watched.check()


def _largest(table: fitter.Table, theta_i_deg: float) -> float:
    """Of channel G in the plane of incidence, where it was measured."""
    from fitter.views import in_plane

    found = in_plane(table, theta_i_deg, n=359)
    return float(found.values[~found.extrapolated, 1].max())


def _run(command: str, folder: Path) -> None:
    words = command.replace("brdf-fitter", f"{sys.executable} -m fitter", 1)
    subprocess.run(["sh", "-c", words], check=True, capture_output=True, cwd=folder, timeout=120)


def test_problems_in_their_own_words(watch: Callable[..., Watched], address: str) -> None:
    watched = watch(address, PHONE, color_scheme="dark")
    page = watched.page
    page.goto(address)
    dropped = page.evaluate_handle(
        "(text) => { const moved = new DataTransfer(); moved.items.add(new File([text], 'bad.csv'));"
        " return moved; }",
        "theta_i_deg,theta_o_deg,dphi_deg,brdf\n0,0,0,1\n30,10,0,many\n",
    )
    page.dispatch_event(".drop", "drop", {"dataTransfer": dropped})
    said = page.get_by_role("alert")
    expect(said).to_contain_text("row")
    expect(said).to_contain_text("Remedy")
    watched.accessible("a problem on a phone in the dark")
    watched.fits_in_width("a problem on a phone")
    # A refusal is an error to the browser's console, and the only one.
    assert all("422" in complaint for complaint in watched.complaints), watched.complaints
    assert not watched.strangers


def test_a_phone_is_wide_enough(watch: Callable[..., Watched], address: str, table: str, fit: str) -> None:
    watched = watch(address, PHONE)
    page = watched.page
    headings = {"table": "Quality check", "look": "Coverage", "fit": "What to fit", "take": "Export"}
    for panel, there in headings.items():
        page.goto(f"{address}/?table={table}&panel={panel}")
        expect(page.get_by_role("heading", name=there)).to_be_visible()
        if panel == "look":
            drawn(page.locator("#panel-look .plot").last)
        watched.fits_in_width(panel)
    watched.check()


def test_keyboard(watch: Callable[..., Watched], address: str, table: str) -> None:
    """From the start to a slice without a mouse."""
    watched = watch(address)
    page = watched.page
    page.goto(f"{address}/?table={table}&panel=take")
    expect(page.get_by_role("heading", name="Export")).to_be_visible()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    for _ in range(2):
        page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Look"
    page.keyboard.press("Enter")
    slider = page.get_by_label("Incidence θ_i")
    expect(slider).to_be_visible()
    drawn(page.locator("#panel-look .plot").nth(1))
    slider.focus()
    page.keyboard.press("ArrowRight")
    plot = page.locator("#panel-look .plot").nth(1)
    expect(plot).to_have_attribute("aria-label", re.compile("of 45.5°"))
    watched.check()


def test_cancelled_and_run_again(watch: Callable[..., Watched], serving: Any, table_bytes: bytes) -> None:
    """Each kind of fit, at a service whose jobs all wait: what is run again is what was asked for."""
    client = serving(workers=0)
    table = client.post("/v1/tables", content=table_bytes).json()["id"]
    with listening(client.app) as address:
        watched = watch(address)
        page = watched.page
        page.goto(f"{address}/?panel=fit&table={table}")
        fit = page.locator("#panel-fit")
        for auto in (False, True):
            if auto:
                fit.get_by_role("checkbox", name=re.compile("^auto")).check()
            fit.get_by_label("Metric").select_option("log")
            fit.get_by_label(re.compile("^Budget")).fill("3")
            fit.get_by_role("button", name="Fit", exact=True).click()
            fit.get_by_role("button", name="Cancel").click()
            expect(fit.get_by_role("alert")).to_contain_text("Cancelled")
            fit.get_by_role("button", name="Run it again").click()
            expect(fit.get_by_role("button", name="Cancel")).to_be_visible()
            again, first = client.get("/v1/jobs").json()["items"][:2]
            assert (first["state"], again["state"]) == ("cancelled", "queued")
            assert first["request"] == again["request"]
            assert ("selection" in first["request"]) == auto
            fit.get_by_role("button", name="Cancel").click()
            expect(fit.get_by_role("alert")).to_contain_text("Cancelled")
        watched.check()
        page.context.close()


def test_a_job_ends_after_another_table_was_chosen(
    watch: Callable[..., Watched], client: Any, address: str, table: str, job: dict[str, Any]
) -> None:
    """Its fits don't become those of the other table."""
    other = client.post("/v1/tables?name=another", content=small_table(7)).json()["id"]
    watched = watch(address)
    page = watched.page
    held: list[Route] = []
    running = {**job, "state": "running", "results": []}
    page.route(f"**/v1/jobs/{job['id']}", lambda route: route.fulfill(json=running))
    page.route(f"**/v1/jobs/{job['id']}/events", lambda route: held.append(route))
    with page.expect_request(f"**/v1/jobs/{job['id']}/events"):
        page.goto(f"{address}/?table={table}&panel=fit&job={job['id']}")
    open_panel(page, "Measurement")
    page.get_by_role("link", name="another").click()
    expect(page.get_by_role("heading", name="another")).to_be_visible()
    drawn(page.locator("#panel-table .plot"))
    with page.expect_response(f"**/v1/jobs/{job['id']}/events"):
        held[0].fulfill(content_type="text/event-stream", body=f"id: 9\ndata: {json.dumps(job)}\n\n")
    page.wait_for_timeout(500)
    assert set(re.findall(r"[?&](\w+)=", page.url)) == {"table"}
    open_panel(page, "Fit")
    expect(page.locator("#panel-fit")).to_contain_text("Nothing runs.")
    assert f"table={other}" in page.url
    watched.check()


def test_a_plot_comes_back_after_a_problem(watch: Callable[..., Watched], address: str, table: str) -> None:
    watched = watch(address)
    page = watched.page
    page.goto(f"{address}/?table={table}&panel=look")
    lobe = page.locator("#panel-look .plot").first
    drawn(lobe)
    away = {"title": "Away", "detail": "the database is away", "status": 503}
    page.route("**/lobe?*", lambda route: route.fulfill(status=503, json=away))
    page.get_by_role("button", name="θ_i = 20°").click()
    expect(lobe.get_by_role("alert")).to_contain_text("the database is away")
    page.unroute("**/lobe?*")
    page.get_by_role("button", name="θ_i = 40°").click()
    expect(lobe).to_have_attribute("aria-label", re.compile("of 40°"))
    expect(lobe.locator("canvas").first).to_be_visible()
    before = page.evaluate("JSON.stringify(document.querySelector('#panel-look .plot').camera)")
    page.get_by_role("button", name="turn left").click()
    expect(lobe.locator("canvas").first).to_be_visible()
    assert page.evaluate("JSON.stringify(document.querySelector('#panel-look .plot').camera)") != before
    assert all("503" in complaint for complaint in watched.complaints), watched.complaints


def test_a_forged_link_asks_for_nothing_else(watch: Callable[..., Watched], address: str, table: str) -> None:
    """What stands for an id in an address does not become another path."""
    watched = watch(address)
    page = watched.page
    asked: list[str] = []
    page.on("request", lambda request: asked.append(f"{request.method} {request.url}"))
    page.goto(f"{address}/?panel=look&table={table}&overlay=..%2Fjobs%2F{table}%2Fcancel%3F")
    drawn(page.locator("#panel-look .plot").nth(1))
    assert not [one for one in asked if one.startswith("POST")]
    page.goto(f"{address}/?panel=constructor&table=..%2F..%2Fopenapi.json%3F")
    expect(page.locator("#subject")).to_have_text("no measurement chosen")
    expect(page.locator("#panel-table")).to_be_visible()
    watched.check()


def test_a_key_is_asked_for_and_sent(watch: Callable[..., Watched], serving: Any, table_bytes: bytes) -> None:
    client = serving(keys=True)
    _, secret = keys.create(client.app.state.service.store, "ann", "write")
    client.post("/v1/tables?name=mine", content=table_bytes, headers={"Authorization": f"Bearer {secret}"})
    with listening(client.app) as address:
        watched = watch(address)
        page = watched.page
        page.goto(address)
        dialog = page.get_by_role("dialog")
        expect(dialog).to_contain_text("This server asks for an API key")
        watched.accessible("asking for a key")
        dialog.get_by_label("Key", exact=True).fill(secret)
        dialog.get_by_role("button", name="Use this key").click()
        page.get_by_role("link", name="mine").click()
        expect(page.get_by_role("heading", name="mine")).to_be_visible()
        drawn(page.locator("#panel-table .plot"))
        expect(page.locator(".findings li").first).to_be_visible()
        open_panel(page, "Take away")
        commands = page.get_by_role("region", name="calls of Measurement")
        expect(commands).to_contain_text("Bearer $BRDF_FITTER_KEY")
        assert secret not in page.content()
        assert secret not in page.url
        assert all("401" in complaint for complaint in watched.complaints), watched.complaints
        assert not watched.strangers
        page.context.close()


def test_without_a_browser(client: Any) -> None:
    """The page's headers, its files, and that it names nothing else."""
    page = client.get("/")
    policy = dict(part.split(" ", 1) for part in page.headers["content-security-policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == "'self'"
    assert "unsafe" not in policy["style-src-elem"]
    assert not re.search(r"<script(?![^>]*src=)|<style| on\w+=| style=", page.text)
    named = re.findall(r'(?:src|href)="(page/[^"]*)"', page.text)
    assert len(named) > 15
    for name in [*named, named[0].rsplit("/", 1)[0] + "/plotly.js"]:
        answer = client.get(f"/{name}")
        assert answer.status_code == 200, name
        assert "immutable" in answer.headers["cache-control"]
        assert answer.headers["content-security-policy"] == page.headers["content-security-policy"]
        plain = client.get(f"/{name}", headers={"accept-encoding": "identity"})
        assert "content-encoding" not in plain.headers
        assert plain.content == answer.content
    digest = named[0].split("/")[1]
    for missing in (f"{digest}/index.html", "0/app.js", f"{digest}/%2e%2e/app.py", f"{digest}//etc/passwd"):
        assert client.get(f"/page/{missing}").status_code == 404
