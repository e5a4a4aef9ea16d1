"""What holds for every target of the registry, and for the command and the service around it."""

from __future__ import annotations

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fitter
from fitter import models
from fitter.cli.app import main
from fitter.errors import SpecError
from fitter.export import subject, target, targets, write, write_draws
from fitter.fitting import FitResult
from fitter.posterior import Posterior
from fitter.spec import posterior_spec
from fitter.table import Table
from tests.export.conftest import held_to_the_contract, make

DOCS = Path(__file__).resolve().parents[2] / "docs" / "export.md"
#: Those that take a second or more are held to the same in the tests of what they write.
DEAR = {"merl", "rgl", "zemax", "pab-opto", "klems", "tensor-tree"}
MODELS = [entry.name for entry in targets() if entry.models and entry.name not in DEAR]


@pytest.fixture(scope="module")
def table() -> Table:
    return fitter.load(DOCS.parents[1] / "data" / "tables" / "glossy_paint.csv")


@pytest.fixture(scope="module")
def fit(table: Table) -> FitResult:
    return fitter.fit(table, "ward", starts=4)


def test_every_target_is_documented() -> None:
    rows = {
        line.split("|")[1].strip(" `"): line for line in DOCS.read_text().splitlines() if line[:3] == "| `"
    }
    for entry in targets():
        takes = " and ".join(["models"] * entry.models + ["tables"] * entry.tables)
        assert rows[entry.name].split("|")[3].strip() == takes, entry.name
    assert set(rows) == {entry.name for entry in targets()}


@pytest.mark.parametrize("name", MODELS)
def test_a_fit_is_written_whole_and_named(fit: FitResult, name: str, tmp_path: Path) -> None:
    entry = target(name)
    path = tmp_path / f"material{entry.suffix}"
    held_to_the_contract(write(fit, name, path, name="my paint"))


def test_parameters_are_the_models_with_their_uncertainties(fit: FitResult, tmp_path: Path) -> None:
    write(fit, "json", tmp_path / "m.json")
    document = json.loads((tmp_path / "m.json").read_text())
    assert models.from_dict(document["model"]).to_dict() == fit.model.to_dict()
    for name, estimate in fit.parameters.items():
        assert (
            document["parameters"][name]["standard_uncertainty"] == estimate.to_dict()["standard_uncertainty"]
        )
        assert document["parameters"][name]["unit"] == estimate.unit
    assert document["provenance"]["table"]["hash"] == fit.table["hash"]
    assert document["provenance"]["status"] == fit.status
    assert "1/sr" in document["convention"]


def test_sources_say_where_they_come_from(fit: FitResult, tmp_path: Path) -> None:
    for name in ("c", "python", "glsl", "disney"):
        write(fit, name, tmp_path / name)
        text = (tmp_path / name).read_text()
        assert str(fit.table["hash"])[:16] in text
        assert "without the cosine" in text
        assert "(u = " in text


def test_a_fit_that_did_not_converge_is_refused_or_flagged(fit: FitResult, tmp_path: Path) -> None:
    lost = replace(fit, status="not_converged", message="the search ended at 3 % above the optimum")
    with pytest.raises(SpecError, match="3 % above the optimum") as refused:
        write(lost, "json", tmp_path / "m.json")
    assert refused.value.code == "fit-not-converged"
    assert not list(tmp_path.iterdir())
    told = write(lost, "json", tmp_path / "m.json", unconverged=True)
    assert [note.code for note in told.notes] == ["not-converged"]
    assert json.loads((tmp_path / "m.json").read_text())["provenance"]["status"] == "not_converged"


def test_the_wrong_kind_and_unknown_targets_are_refused(table: Table, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="holds a model, and this is a table"):
        write(table, "c", tmp_path / "m.c")
    with pytest.raises(SpecError, match="nothing called 'obj'"):
        write(table, "obj", tmp_path / "m.obj")
    assert subject(models.create("ward", channels=("450nm", "red"))).channels[0].wavelength_nm == 450
    assert not list(tmp_path.iterdir())


def test_the_command(fit: FitResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fit.save(tmp_path / "fit.json")
    call = ["export", str(tmp_path / "fit.json"), "--to", "c", "--out", str(tmp_path / "m.c")]
    assert main([*call, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["kind"], told["to"], told["path"]) == ("brdf-fitter/export", "c", str(tmp_path / "m.c"))
    assert main(call) == 0
    assert "f_r in 1/sr" in capsys.readouterr().out
    (tmp_path / "model.json").write_text(json.dumps(make("ward").to_dict()))
    assert (
        main(["export", str(tmp_path / "model.json"), "--to", "json", "--out", str(tmp_path / "n.json")]) == 0
    )
    assert main(["export", str(DOCS), "--to", "c", "--out", str(tmp_path / "n.c")]) == 2
    assert not (tmp_path / "n.c").exists()


def test_the_service(tmp_path: Path) -> None:
    from api.app import create_app
    from api.settings import Settings
    from tests.api.conftest import TestClient, small_table

    ward = make("ward")
    with TestClient(create_app(Settings(folder=tmp_path / "data"))) as client:
        values = {name: np.asarray(value).tolist() for name, value in ward.values.items()}
        model = client.post("/v1/models", json={"model": "ward", "values": values}).json()
        link = model["links"]["export"]
        listed = client.get("/v1/export-targets").json()
        assert [one["name"] for one in listed] == [entry.name for entry in targets()]
        answer = client.get(link.format(format="c"))
        assert answer.status_code == 200
        assert "attachment" in answer.headers["content-disposition"]
        write(subject(ward, name="ward"), "c", tmp_path / "m.c")
        assert answer.content == (tmp_path / "m.c").read_bytes()
        assert json.loads(answer.headers["export-notes"]) == {"notes": [], "residuals": {}}
        table = client.post("/v1/tables", content=small_table()).json()
        shown = client.get(table["links"]["export"].format(format="gltf"))
        assert shown.headers["content-type"] == "model/gltf+json"
        assert "differs from the table" in json.loads(shown.headers["export-notes"])["notes"][0]["message"]
        for place, wrong in ((link, "obj"), (table["links"]["export"], "c")):
            problem = client.get(place.format(format=wrong))
            assert problem.status_code == 422, problem.text
            assert problem.headers["content-type"] == "application/problem+json"
        assert client.get("/v1/models/0/export/c").status_code == 404


def test_exports_take_turns_and_hold_nobody_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fastapi import Response

    from api.app import create_app
    from api.exports import respond_export
    from api.routes import models as routes
    from api.service import EXPORTS
    from api.settings import Settings
    from tests.api.conftest import TestClient

    go, running, most = threading.Event(), [0], [0]

    def held(what: Any, to: str, **options: Any) -> Any:
        if to == "gltf":
            running[0] += 1
            most[0] = max(most[0], running[0])
            assert go.wait(60)
            running[0] -= 1
            return Response()
        return respond_export(what, to, **options)

    monkeypatch.setattr(routes, "respond_export", held)
    values = {name: np.asarray(value).tolist() for name, value in make("ward").values.items()}
    with (
        TestClient(create_app(Settings(folder=tmp_path / "data"))) as client, ThreadPoolExecutor(50) as pool,
    ):  # fmt: skip
        link = client.post("/v1/models", json={"model": "ward", "values": values}).json()["links"]["export"]
        # More than the server has threads.
        asked = [pool.submit(client.get, link.format(format="gltf")) for _ in range(48)]
        try:
            while running[0] < EXPORTS:
                time.sleep(0.01)
            assert client.get(link.format(format="glsl")).status_code == 200
            assert client.get("/v1/models").status_code == 200
            assert not any(one.done() for one in asked)
        finally:
            go.set()
        assert {one.result().status_code for one in asked} == {200}
    assert most[0] == EXPORTS


@pytest.fixture(scope="module")
def posterior(fit: FitResult) -> Posterior:
    """A posterior that is what the fit's covariance says, drawn here."""
    centre = [float(np.ravel(fit.parameters[label.partition("[")[0]].value)[0]) for label in fit.labels]
    spread = np.sqrt(np.nan_to_num(np.diag(fit.covariance)))
    draws = np.random.default_rng(4).normal(centre, spread, (50, len(centre)))
    return Posterior(
        spec=posterior_spec({}), fit_spec=fit.spec, template=fit.model, labels=fit.labels,
        draws=np.abs(draws), noise={}, diagnostics={}, acceptance=0.3, status="converged",
        message="made here", history=(), cost={"seconds": 0.0}, table=fit.table,
    )  # fmt: skip


def test_draws_are_a_set_of_materials(
    posterior: Posterior, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = write_draws(posterior, "json", tmp_path / "set", 5)
    listed = json.loads((tmp_path / "set" / "draws.json").read_text())
    assert told.path == tmp_path / "set"
    assert listed["table"]["hash"] == posterior.table["hash"]
    for entry, model in zip(listed["draws"], posterior.models(5), strict=True):
        document = json.loads((tmp_path / "set" / entry["file"]).read_text())
        assert models.from_dict(document["model"]).to_dict() == model.to_dict()
        assert entry["values"] == model.to_dict()["values"]
    posterior.save(tmp_path / "p.json")
    call = ["export", str(tmp_path / "p.json"), "--to", "c", "--out", str(tmp_path / "c")]
    assert main([*call, "--draws", "3"]) == 0
    assert len(list((tmp_path / "c").glob("draw_*.c"))) == 3
    assert "Draw 2 of 3 of the posterior of glossy_paint" in (tmp_path / "c" / "draw_0002.c").read_text()
    capsys.readouterr()
    assert main(call) == 2  # how many is not said
    assert main([*call, "--draws", "3"]) == 2  # the folder is not empty
    assert "new or empty folder" in capsys.readouterr().err
    for count in (0, 51):
        with pytest.raises(SpecError, match="there are 50"):
            write_draws(posterior, "json", tmp_path / "none", count)
    lost = replace(posterior, status="not_converged", message="R-hat is 1.3")
    with pytest.raises(SpecError, match=r"R-hat is 1\.3"):
        write_draws(lost, "json", tmp_path / "none", 2)
    assert not (tmp_path / "none").exists()
    assert write_draws(lost, "json", tmp_path / "lost", 2, unconverged=True).notes[0].code == "not-converged"
