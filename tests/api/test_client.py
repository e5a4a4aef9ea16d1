"""The client over a real socket, and the command line that has a service do its work."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from api.client import Client, Refused, ServiceFailed
from fitter.cli import main
from fitter.errors import FitError, SpecError
from fitter.fitting import load_fit
from fitter.progress import Cancelled

from .conftest import small_table


@pytest.fixture(scope="module")
def service(address: str) -> Iterator[Client]:
    with Client(address) as opened:
        yield opened


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("client") / "paint.csv"
    path.write_bytes(small_table())
    return path


def test_main_path(service: Client, file: Path) -> None:
    table = service.upload(file)
    assert table.name == "paint.csv"
    assert table in list(service.tables())
    reported: list[tuple[float, str]] = []
    started = service.start("fits", table=table.id, model="oren_nayar")
    done = service.wait(started, lambda share, what: reported.append((share, what)))
    assert done.state == "done"
    assert reported
    fit = service.fit(done.results[0]["id"])
    assert fit["status"] == "converged"
    wi, wo = np.array([[0.0, 0.0, 1.0]]), np.array([[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    values = service.evaluate("models", fit["id"], wi, wo)
    assert values.shape == (2, 3)
    assert service.evaluate("tables", table.id, wi, wo)["value"].shape == (2, 3)
    with file.open("rb") as opened:  # an open file is streamed, bytes are sent
        assert service.upload(opened).sha256 == service.upload(file.read_bytes()).sha256
    again = service.read_again(table.id, quantity="ccbrdf", name="divided")
    assert (again.sha256, again.name) == (table.sha256, "divided")
    assert again.options == {**table.options, "quantity": "ccbrdf", "name": "divided"}
    assert again.description["quantity"] == "ccbrdf"
    with pytest.raises(Refused, match="item"):
        service.read_again(table.id, item="7")
    service.delete_table(table.id)
    assert service.check(again.id)["samples"] == 252
    with pytest.raises(Refused) as gone:
        service.table(table.id)
    assert (gone.value.status, gone.value.code) == (404, "not-found")


def test_problems_are_typed_errors(service: Client, tmp_path: Path) -> None:
    with pytest.raises(Refused) as refused:
        service.upload(io.BytesIO(small_table(tail="10,20,thirty,1,1,1\n")), name="paint")
    error = refused.value
    assert (error.status, error.file, error.row) == (422, "paint", len(small_table().splitlines()) + 1)
    assert error.document["type"] == f"/problems/{error.code}"
    with pytest.raises(Refused, match="nonsense"):
        service.upload(small_table(), convention="nonsense")
    with pytest.raises(SpecError, match="can't be read"):
        service.upload(tmp_path)


def test_failed_and_cancelled_jobs_are_errors(service: Client, table: str, fit: str) -> None:
    wanted = {"table": table, "models": ["ward"], "fixed": {"sigma": 0.1}}
    with pytest.raises(Refused, match="sigma"):
        service.start("fits", **wanted)
    twice = service.start("fits", **{**wanted, "models": ["ward", "ward"]})
    with pytest.raises(ServiceFailed, match="sigma"):
        service.wait(twice)

    def stop(share: float, what: str) -> None:
        raise Cancelled

    long = service.start("posteriors", fit=fit, ess=1_000_000, walkers=8, budget_seconds=60)
    with pytest.raises(Cancelled):
        service.wait(long, stop)
    with pytest.raises(FitError, match="cancelled"):
        service.wait(long.id)


def test_nobody_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("api.client.RETRY_AFTER", (0.01, 0.01))
    with Client("http://127.0.0.1:9") as client, pytest.raises(ServiceFailed) as error:
        client.table("x")
    assert error.value.code == "server-unreachable"
    with pytest.raises(SpecError, match="no URL"):
        Client("127.0.0.1:8000")


def test_an_attempt_that_is_still_worked_on_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    names: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        names.append(request.headers["idempotency-key"])
        if len(names) < 6:
            busy = {"code": "in-flight", "detail": "x"}
            return httpx.Response(409, headers={"Retry-After": "0"}, json=busy)
        return httpx.Response(201, json={})

    with httpx.Client(base_url="http://here", transport=httpx.MockTransport(answer)) as http:
        assert Client(http=http).request("POST", "/v1/models").status_code == 201
        # The same request, however often; and no longer than an attempt can take.
        assert len(names) == 6
        assert len(set(names)) == 1
        names.clear()
        monkeypatch.setattr("api.client.IN_FLIGHT", 0.0)
        with pytest.raises(Refused, match="x"):
            Client(http=http).request("POST", "/v1/models")


@pytest.fixture(scope="module")
def fits(address: str, file: Path) -> Path:
    folder = file.parent / "fits"
    words = ["fit", str(file), "--model", "oren_nayar", "--model", "ward", "--fixed", "alpha=0.2"]
    assert main(["--server", address, *words, "--out", str(folder)]) == 0
    return folder


def _ran(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    status = main([str(word) for word in words])
    out, err = capsys.readouterr()
    assert status == 0, err
    return json.loads(out) if "--json" in words else out


@pytest.mark.long
def test_a_service_does_what_the_command_does(
    address: str, file: Path, fits: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """info, check, sample and posterior: the same documents, but for what says where it was done."""
    there = ("--server", address)
    for words in (("info", file), ("check", file)):
        here, away = _ran(capsys, *words, "--json"), _ran(capsys, *there, *words, "--json")
        away.pop("id")
        assert {**away, "name": ""} == {**here, "name": ""}
        assert _ran(capsys, *there, *words)
    draw = ("-n", 50, "--seed", 3, "--theta-i", 20, "--json")
    for words in (("sample", file, *draw), ("sample", "--model", fits / "ward.json", *draw)):
        here, away = _ran(capsys, *words), _ran(capsys, *there, *words)
        for document in (here, away):
            document["of"] = None
        # The header says the acceptance to six digits.
        assert away.pop("acceptance") == pytest.approx(here.pop("acceptance"), rel=1e-5)
        assert away == here
    short = ("posterior", fits / "oren_nayar.json", "--ess", 50, "--budget-seconds", 3, "--max-samples", 50)
    assert _ran(capsys, *there, *short, "--json")["kind"] == "brdf-fitter/posterior"


@pytest.mark.long
def test_fits_of_a_service_are_results_like_any(
    address: str, fits: Path, fit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from fitter import load_fit

    assert load_fit(fits / "ward.json").parameters["alpha"].value == pytest.approx(0.2)
    # That fit's report is looked at elsewhere, too, and made once.
    _ran(capsys, "--server", address, "report", fit, "--out", tmp_path)
    assert b"<html" in (tmp_path / "report.html").read_bytes()
    assert json.loads((tmp_path / "report.json").read_bytes())


def test_wrong_calls_say_so(
    address: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = ("fit", file, "--model", "ward")
    local = tmp_path / "local.json"
    local.write_text('{"kind": "brdf-fitter/fit", "spec": {"model": {"family": "ward"}}}')
    for words, said in (
        (("compress", file, "--tolerance", 0.1, "--out", "x"), "does not do the work of `compress`"),
        ((*fit, "--compress", "0.1"), "--compress can't go with --server"),
        (("report", local, "--out", tmp_path), "the service does not know this fit"),
        (("info", tmp_path), "give one file"),
        (("fit", file, "--model", "ward", "--channels", "X"), "brdf-fitter: error"),
    ):
        status = main(["--server", address, *(str(word) for word in words)])
        assert status in (1, 2)
        assert said in capsys.readouterr().err


def test_a_batch_of_a_service_s_tables(
    service: Client, address: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Fetched once, read with their options, fitted here; unknown ids are told before any work."""
    ids = [service.upload(file, name="paint").id, service.upload(file, name="paint", quantity="ccbrdf").id]
    assert b"".join(service.content(ids[0])) == file.read_bytes()
    out = tmp_path / "out"
    spec = tmp_path / "b.yaml"
    spec.write_text(f"tables: ['server:{ids[0]}', 'server:{ids[1]}']\nmodels: [oren_nayar]\nreport: false\n")
    words = ["--server", address, "batch", str(spec), "--out", str(out), "--workers", "1", "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["done"] == 2
    first, second = (
        load_fit(out / "tables" / f"paint-{id[:8]}" / "oren_nayar.json").parameters["rho"].value[0]
        for id in ids
    )
    assert second > 1.05 * first
    monkeypatch.setattr(Client, "content", None)
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["kept"] == 2
    unknown = ids[0][::-1]
    assert main(["--server", address, "batch", unknown, ids[0], "--out", str(tmp_path / "none")]) == 2
    assert unknown in capsys.readouterr().err
    assert main(["batch", str(spec), "--out", str(tmp_path / "none")]) == 2
    assert "--server" in capsys.readouterr().err
    dry = ["--dry-run", "--model", "lambert", "--no-report", "--out", str(tmp_path / "none")]
    monkeypatch.undo()
    assert main(["--server", address, "batch", ids[0], *dry]) == 0
    assert not (tmp_path / "none").exists()


def test_what_a_service_says_is_not_trusted_with_files(
    service: Client, address: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Other bytes than those uploaded, ids that are paths, names that differ in what would be a suffix."""
    ids = [service.upload(file, name=f"gold 1.{k}").id for k in (1, 2)]
    out = tmp_path / "deep" / "out"
    words = ["--server", address, "batch", "--model", "lambert", "--no-report", "--workers", "1", "--out"]
    words.append(str(out))

    told = Client.table
    monkeypatch.setattr(
        Client, "table", lambda self, id: told(self, id).model_copy(update={"id": f"../../{id}"})
    )
    with monkeypatch.context() as changed:
        changed.setattr(Client, "content", lambda self, id: iter([b"other bytes"]))
        assert main([*words, *ids]) == 1
    assert "other bytes came" in capsys.readouterr().err
    assert main([*words, *ids]) == 0
    assert {path.name for path in (out / "fetched").iterdir()} == set(ids)
    assert {path.name for path in (out / "tables").iterdir()} == {f"gold_1-{id[:8]}" for id in ids}
    assert [path.name for path in tmp_path.iterdir()] == ["deep"]

    assert main([*words, f"server:../fits/{ids[0]}"]) == 2
    assert "32 hexadecimal digits" in capsys.readouterr().err
