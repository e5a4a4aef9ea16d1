"""Remote: verbs of the command line whose work a service does (``brdf-fitter --server URL VERB``)."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import httpx
import numpy as np
from numpy.typing import NDArray

from api.client import Client, Document, ServiceFailed
from api.fetching import ID, fetched
from api.schemas import TableDocument
from fitter.batch import SERVER
from fitter.cli import reading
from fitter.cli.results import fits_document, show_fit
from fitter.cli.screen import Screen
from fitter.cli.values import output_file, output_folder
from fitter.cli.verb import DONE, WORK_FAILED, Outcome
from fitter.cli.verbs import batch as batch_verb
from fitter.cli.verbs import fit as fit_verb
from fitter.cli.verbs import sample as sample_verb
from fitter.cli.verbs.check import show_check
from fitter.cli.verbs.info import show_table
from fitter.cli.verbs.posterior import posterior_asked, show_posterior
from fitter.directions import vector_from_spherical
from fitter.documents import FITS, file_stem, read_document, write_bytes, write_document
from fitter.errors import SpecError
from fitter.quality import Check, Finding
from fitter.spec import ModelSpec

#: More incidences than this have no slices in the service's answer.
MOST_SLICES = 16
_Run = Callable[[Client, argparse.Namespace, Screen], Outcome]


def run(given: argparse.Namespace, screen: Screen, *, key: str | None) -> Outcome:
    """Have the service do the work of a verb. Raises FitterError, as the verb and the client do."""
    verbs: Mapping[str, _Run] = {
        "info": _info, "check": _check, "fit": _fit, "posterior": _posterior, "report": _report,
        "sample": _sample, "batch": _batch,
    }  # fmt: skip
    if given.verb not in verbs:
        raise SpecError(
            f"a service does not do the work of `{given.verb}`", code="bad-call", parameter="server",
            remedy=f"leave out --server, or use one of {', '.join(verbs)}",
        )  # fmt: skip
    for option in ("out_of_core", "compress", "checkpoint"):
        if getattr(given, option, None):
            _no(option)
    with Client(given.server, key=key) as client:
        return verbs[given.verb](client, given, screen)


def _no(option: str) -> None:
    raise SpecError(
        f"--{option.replace('_', '-')} can't go with --server", code="bad-call", parameter=option,
        remedy="leave out one of them",
    )  # fmt: skip


def _table(client: Client, given: argparse.Namespace) -> TableDocument:
    """The table that is meant: by its id on the service, else uploaded now."""
    if ID.fullmatch(given.table) and not Path(given.table).exists():
        return client.table(given.table)
    return client.upload(given.table, **reading.reading_options(given).to_dict())


def _info(client: Client, given: argparse.Namespace, screen: Screen) -> Outcome:
    folder = None if given.plot is None else output_folder(given.plot, "plot")
    table = _table(client, given)
    document = {**client.document(f"/v1/tables/{table.id}/info"), "id": table.id}
    if folder is not None:
        path = folder / f"{file_stem(table.name)}.png"
        write_bytes(client.request("GET", f"/v1/tables/{table.id}/picture.png").content, path)
        document["picture"] = str(path)
    return Outcome(document, lambda screen: show_table(document, screen))


def _check(client: Client, given: argparse.Namespace, screen: Screen) -> Outcome:
    with screen.progress("check"):
        table = _table(client, given)
        document = client.check(table.id, given.seed)
    found = Check(
        name=document["name"], hash=document["hash"], samples=document["samples"],
        looked_at=document["looked_at"], seed=document["seed"],
        findings=tuple(Finding(**one) for one in document["findings"]),
    )  # fmt: skip
    return Outcome({**document, "id": table.id}, lambda screen: show_check(found, screen))


def _fit(client: Client, given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.fitting import FitResult

    chosen_by = fit_verb.selection(given)
    out = None if given.out is None else output_folder(given.out)
    asked: list[tuple[str, Document]]
    if chosen_by is not None:
        asked = [("auto", {"model": "auto", **_given(chosen_by.model_dump(mode="json"))})]
    else:
        specs = fit_verb.specs(given)
        asked = [(spec.model.name, _given(spec.model_dump(mode="json"))) for spec in specs]
    with screen.progress("upload"):
        table = _table(client, given)
    # All wait at once: a service with several workers fits several models at a time.
    jobs = [(name, client.start("fits", table=table.id, **one)) for name, one in asked]
    fits: list[Document] = []
    failures: list[Document] = []
    selection: Document | None = None
    for name, job in jobs:
        try:
            with screen.progress(name) as progress:
                done = client.wait(job, progress)
        except ServiceFailed as error:
            screen.note(f"error: {name}: {error}")
            failures.append({"model": name, "error": error.to_dict()})
            continue
        for one in done.results:
            if one["kind"] == "selection":
                selection = {name: item for name, item in one.items() if name != "kind"}
                continue
            document = _remembering(client.fit(one["id"]), given)
            fits.append(document)
            if out is not None:
                write_document(document, out / ModelSpec.parse(one["model"]).file_name)
    results = [FitResult.from_dict(document) for document in fits]

    def show(screen: Screen) -> None:
        for sentence in selection["sentences"] if selection is not None else ():
            screen.line(sentence)
        for result in results:
            show_fit(result, screen)
            screen.line()
        if out is not None and results:
            written = [str(out / result.spec.model.file_name) for result in results]
            screen.line(f"written: {', '.join(written)}")

    status = WORK_FAILED if failures else DONE
    document = fits_document(fits, failures)
    if selection is not None:
        document = {"kind": FITS, "fits": fits, "failures": failures, "selection": selection}
    return Outcome(document, show, status)


def _remembering(document: Document, given: argparse.Namespace) -> Document:
    """The fit, knowing which file its table came from: verbs that work here find it, too."""
    if not Path(given.table).exists():
        return document
    options = reading.reading_options(given).to_dict()
    source = {"path": str(Path(given.table).resolve()), "options": options}
    return {**document, "table": {**document["table"], "source": source}}


def _posterior(client: Client, given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.posterior import Posterior

    out = None if given.out is None else output_file(given.out)
    spec = posterior_asked(given)
    fit = _fit_id(given.result, given.model)
    with screen.progress("posterior") as progress:
        done = client.wait(
            client.start("posteriors", fit=fit, **_given(spec.model_dump(mode="json"))), progress
        )
    document = client.posterior(done.results[0]["id"])
    posterior = Posterior.from_dict(document)
    if out is not None:
        write_document(document, out)
    if posterior.status != "converged":
        screen.note(f"{posterior.status.replace('_', ' ')}: {posterior.message}")

    def show(screen: Screen) -> None:
        show_posterior(posterior, screen)
        if out is not None:
            screen.line(f"written: {out}")

    return Outcome(document, show)


def _report(client: Client, given: argparse.Namespace, screen: Screen) -> Outcome:
    for option in ("table", "posterior"):
        if getattr(given, option):
            _no(option)  # the service knows the fit's table and its latest posterior
    if len(given.result) > 1:
        raise SpecError(
            "a service reports on one fit at a time", code="bad-call", parameter="result",
            remedy="give one RESULT.json",
        )  # fmt: skip
    out = output_folder(given.out)
    fit = _fit_id(given.result[0], given.model)
    written = {"html": out / "report.html", "json": out / "report.json"}
    if given.pdf:
        written["pdf"] = out / "report.pdf"
    with screen.progress("report") as progress:
        for k, (kind, path) in enumerate(written.items()):
            progress(k / len(written), kind)
            write_bytes(client.report(fit, cast("Any", kind)), path)
    paths = {kind: str(path) for kind, path in written.items()}
    document = {"kind": "brdf-fitter/report-written", "fit": fit, "pdf": None, **paths}
    return Outcome(document, lambda screen: screen.line(f"written: {', '.join(paths.values())}"))


def _sample(client: Client, given: argparse.Namespace, screen: Screen) -> Outcome:
    out = sample_verb.checked(given)
    angles: list[float] = given.theta_i or []
    wi = vector_from_spherical(np.deg2rad(angles), np.deg2rad(given.phi_i)).tolist()
    wanted: Document = {"n": given.count, "seed": given.seed}
    if wi:
        wanted["wi"] = wi if len(wi) > 1 else wi[0]
    slices: list[Document] | None = None
    if given.model is not None:
        model = client.model(_fit_id(given.model, None))
        array, headers = client.sample("models", model.id, **wanted)
        channels, origin = model.channels, {"model": model.name, "path": given.model}
    else:
        more = {
            "weights": given.weights, "method": given.method, "max_evaluations": given.max_evaluations,
            "allow_extrapolated": given.extrapolate,
        }  # fmt: skip
        wanted |= {name: value for name, value in more.items() if value is not None}
        table = _table(client, given)
        with screen.progress("draws"):
            array, headers = client.sample("tables", table.id, **wanted)
        if wi and len(wi) <= MOST_SLICES:
            # An array has no place for them: one more draw as JSON, from the sampler that is ready by now.
            answer = client.request("POST", f"/v1/tables/{table.id}/samples", json={**wanted, "n": 1})
            slices = answer.json()["slices"]
        channels = [str(channel["name"]) for channel in table.description["channels"]]
        origin = {"table": table.name, "path": given.table, "id": table.id}
    return sample_verb.outcome(given, _samples(array, headers), channels, origin, slices, out)


def _batch(client: Client, given: argparse.Namespace, screen: Screen) -> Outcome:
    """The work is done here; tables that are named by ids come from the service."""
    given.tables = [
        f"{SERVER}{one}" if ID.fullmatch(one) and not Path(one).exists() else one for one in given.tables
    ]
    return batch_verb.run(given, screen, lambda spec, folder: fetched(client, spec, folder, screen))


def _samples(array: NDArray[Any], headers: httpx.Headers) -> Any:
    from fitter.sampling import Samples

    evaluations = headers["Sampling-Evaluations"]
    return Samples(
        **{str(name): np.ascontiguousarray(array[name]) for name in array.dtype.names or ()},
        acceptance=float(headers["Sampling-Acceptance"]), seed=int(headers["Sampling-Seed"]),
        evaluations=None if evaluations == "None" else int(evaluations),
    )  # fmt: skip


def _fit_id(path: str, model: str | None) -> str:
    """The id, on the service, of the fit in a file that ``--server URL fit`` wrote; or that id itself."""
    if ID.fullmatch(path) and not Path(path).exists():
        return path
    document = read_document(Path(path), "not-a-fit")
    parts: list[Any] = document.get("fits", []) if document.get("kind") == FITS else [document]
    if model is not None:
        name = ModelSpec.parse(model).name
        parts = [part for part in parts if ModelSpec(**part["spec"]["model"]).name == name]
    if len(parts) != 1:
        raise SpecError(
            f"the file holds {len(parts)} fits that may be meant, and one is needed", code="which-fit",
            file=path, parameter="model", remedy="name one with --model",
        )  # fmt: skip
    id = parts[0].get("id")
    if not isinstance(id, str):
        raise SpecError(
            "the service does not know this fit", code="not-of-a-service", file=path,
            cause="it was made on this machine", remedy="fit with --server, too, or leave out --server",
        )  # fmt: skip
    return id


def _given(document: Document) -> Document:
    """What was said: null is what it is when it is left out."""
    return {name: item for name, item in document.items() if item is not None}
