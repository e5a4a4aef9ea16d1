"""Documents: rows as the answers show them, with their links."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from api.rows import CalibrationRow, EventRow, JobRow, ModelRow, PosteriorRow, SceneRow, TableRow, TradeoffRow
from api.states import QUEUED, RUNNING


def when(seconds: float) -> str:
    """ISO 8601, UTC, to the millisecond."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def table(row: TableRow) -> dict[str, Any]:
    here = f"/v1/tables/{row.id}"
    verbs = (
        "info", "check", "evaluate", "samples", "slices", "cuts", "lobe", "half-difference", "coverage",
        "readings",
    )  # fmt: skip
    links = {"self": here, **{verb: f"{here}/{verb}" for verb in verbs}}
    links["picture"] = f"{here}/picture.png"
    links["export"] = f"{here}/export/{{format}}"
    return {
        "id": row.id, "name": row.name, "created": when(row.created), "sha256": row.sha256, "bytes": row.size,
        "options": row.options, "description": row.description, "links": links,
    }  # fmt: skip


def job(row: JobRow) -> dict[str, Any]:
    here = f"/v1/jobs/{row.id}"
    links = {"self": here, "events": f"{here}/events"}
    if row.table_id:
        links["table"] = f"/v1/tables/{row.table_id}"
    if row.state in (QUEUED, RUNNING):
        links["cancel"] = f"{here}/cancel"
    return {
        "id": row.id, "kind": row.kind, "state": row.state,
        "progress": {"share": row.share, "what": row.what}, "attempt": row.attempt,
        "table": row.table_id or None,
        "request": row.request, "created": when(row.created),
        "started": None if row.started is None else when(row.started),
        "finished": None if row.finished is None else when(row.finished),
        "results": [_result(one) for one in row.results], "problem": row.problem, "links": links,
    }  # fmt: skip


def job_event(row: JobRow, event: EventRow) -> dict[str, Any]:
    """The job as it was at an event of its log."""
    then = JobRow(id=row.id, kind=row.kind, table_id=row.table_id, request=row.request, created=row.created)
    for name, value in event.data.items():
        setattr(then, name, value)
    return job(then)


def model(row: ModelRow) -> dict[str, Any]:
    return {
        "id": row.id, "origin": row.origin, "name": row.name, "created": when(row.created),
        "spec": row.document["spec"], "channels": row.document["channels"], "values": row.document["values"],
        "links": _model_links(row),
    }  # fmt: skip


def fit(row: ModelRow) -> dict[str, Any]:
    return {
        "id": row.id, "model": row.name, "created": when(row.created), "table": row.table_id,
        "job": row.job_id, **(row.summary or {}), "links": fit_links(row),
    }  # fmt: skip


def fit_links(row: ModelRow) -> dict[str, str]:
    """Links of a fit: its table, its model and what can be asked of it."""
    here = f"/v1/fits/{row.id}"
    return {
        "self": here, "table": f"/v1/tables/{row.table_id}", "job": f"/v1/jobs/{row.job_id}",
        "model": f"/v1/models/{row.id}", "residuals": f"{here}/residuals", "slices": f"{here}/slices",
        "report": f"{here}/report.html", "report_json": f"{here}/report.json",
        "report_pdf": f"{here}/report.pdf",
    }  # fmt: skip


def of_fit(row: PosteriorRow | CalibrationRow) -> dict[str, Any]:
    """What was made of a fit, in a list."""
    return {
        "id": row.id, "created": when(row.created), "fit": row.fit_id, "job": row.job_id, **row.summary,
        "links": of_fit_links(row),
    }  # fmt: skip


def of_fit_links(row: PosteriorRow | CalibrationRow) -> dict[str, str]:
    here = f"/v1/{row.__tablename__}/{row.id}"
    links = {"self": here, "fit": f"/v1/fits/{row.fit_id}", "job": f"/v1/jobs/{row.job_id}"}
    if isinstance(row, PosteriorRow):
        return {**links, "export": f"{here}/export/{{format}}"}
    return {**links, "picture": f"{here}/picture.png"}


def tradeoff(row: TradeoffRow) -> dict[str, Any]:
    links = {"self": f"/v1/tradeoffs/{row.id}", "table": f"/v1/tables/{row.table_id}"}
    links |= {"job": f"/v1/jobs/{row.job_id}", **tradeoff_links(row.id)}
    return {
        "id": row.id, "created": when(row.created), "table": row.table_id, "job": row.job_id, **row.summary,
        "links": links,
    }  # fmt: skip


def tradeoff_links(id: str) -> dict[str, str]:
    """What is drawn of a tradeoff."""
    here = f"/v1/tradeoffs/{id}"
    return {"report": f"{here}/report.html", "picture": f"{here}/picture.png"}


def scene(row: SceneRow) -> dict[str, Any]:
    here = f"/v1/scenes/{row.id}"
    links = {"self": here, "job": f"/v1/jobs/{row.job_id}", **_scene_links(row.id)}
    return {"id": row.id, "created": when(row.created), "job": row.job_id, **row.summary, "links": links}


def _scene_links(id: str) -> dict[str, str]:
    here = f"/v1/scenes/{id}"
    return {"exr": f"{here}/picture.exr", "picture": f"{here}/picture.png"}


def _model_links(row: ModelRow) -> dict[str, str]:
    here = f"/v1/models/{row.id}"
    links = {"self": here, **{verb: f"{here}/{verb}" for verb in ("evaluate", "sample", "pdf", "albedo")}}
    links["export"] = f"{here}/export/{{format}}"
    return {**links, "fit": f"/v1/fits/{row.id}"} if row.origin == "fit" else links


def _result(one: dict[str, Any]) -> dict[str, Any]:
    if "id" not in one:
        return one
    here = f"/v1/{one['kind']}s/{one['id']}"
    links = {"self": here}
    if one["kind"] == "calibration":
        links["picture"] = f"{here}/picture.png"
    if one["kind"] == "tradeoff":
        links |= tradeoff_links(one["id"])
    if one["kind"] == "scene":
        links |= _scene_links(one["id"])
    if one["kind"] == "fit":
        links |= {"model": f"/v1/models/{one['id']}", "report": f"{here}/report.html"}
    return {**one, "links": links}
