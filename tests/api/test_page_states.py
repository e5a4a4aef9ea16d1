"""The page where something is not as usual: refused, cancelled, late, forged, or closed to strangers."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Route, expect

from api import keys

from .browser import PHONE, Watched, drawn, open_panel
from .conftest import listening, small_table


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


@pytest.mark.long
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
