"""Work: what each kind of job does, from its row to result rows that wait to be published."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import fitter
from api.problems import Problem, of_fitter_error
from api.results import Results
from api.rows import CalibrationRow, JobRow, ModelRow, PosteriorRow, Row, SceneRow, TableRow, TradeoffRow
from api.scenes import scene_of
from api.store import Store, new_id
from api.tables import OpenTables
from fitter.errors import FitterError, SpecError
from fitter.progress import Cancelled, Progress
from fitter.spec import calibration_spec, fit_spec, posterior_spec, selection_spec, tradeoff_spec

if TYPE_CHECKING:
    from fitter.fitting import FitResult


@dataclass
class Outcome:
    """What a job made: rows to publish, and its ``results`` as the job document lists them.

    ``problem`` is set where nothing came of it. Files named by the rows' ids are on the disk already.
    """

    rows: list[Row] = field(default_factory=list[Row])
    results: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    problem: dict[str, Any] | None = None


class Worker:
    """Runs jobs. Holds what they read from and write to."""

    def __init__(self, store: Store, results: Results, tables: OpenTables) -> None:
        self._store = store
        self._results = results
        self._tables = tables

    def run(self, job: JobRow, progress: Progress) -> Outcome:
        """Do the job. Raises Cancelled, FitterError, or Problem where what it needs is gone."""
        if job.kind == "scene":
            return self._scene(job, progress)
        row = self._store.get(TableRow, job.table_id)
        if row is None:
            raise Problem.not_found("table", job.table_id)
        table = self._tables.open(row).table
        work = {
            "fit": self._fit, "posterior": self._posterior, "tradeoff": self._tradeoff,
            "calibration": self._calibration,
        }  # fmt: skip
        return work[job.kind](job, table, progress)

    def discard(self, outcome: Outcome) -> None:
        """Delete the files of an outcome that was not published."""
        for row in outcome.rows:
            self._results.drop(row.id)

    def forget(self, job: JobRow) -> None:
        """Delete what a job that has ended kept for another attempt."""
        self._results.drop_checkpoint(job.id)

    def _fit(self, job: JobRow, table: fitter.Table, progress: Progress) -> Outcome:
        if "selection" in job.request:
            return self._select(job, table, progress)
        specs = [fit_spec(one) for one in job.request["specs"]]
        outcome = Outcome()
        for k, spec in enumerate(specs):
            name = spec.model.name

            def step(share: float, what: str, k: int = k, name: str = name) -> None:
                progress((k + share) / len(specs), f"{name}: {what}")

            try:
                fit = fitter.fit(table, spec, progress=step)
            except Cancelled:
                raise
            except FitterError as error:
                # One model that can't be fitted says why; the others are still worth having.
                problem = of_fitter_error(error)
                outcome.results.append({"kind": "fit", "model": name, "problem": problem})
                outcome.problem = outcome.problem or problem
                continue
            outcome.results.append(self._keep_fit(job, fit, outcome))
        if outcome.rows:
            outcome.problem = None
        return outcome

    def _select(self, job: JobRow, table: fitter.Table, progress: Progress) -> Outcome:
        """Compare models: the fits of the best, the chosen one's first, and the comparison."""
        found = fitter.select(table, selection_spec(job.request["selection"]), progress=progress)
        outcome = Outcome()
        outcome.results += [self._keep_fit(job, fit, outcome) for fit in found.fits]
        outcome.results.append({**found.summary(), "kind": "selection"})
        return outcome

    def _keep_fit(self, job: JobRow, fit: FitResult, outcome: Outcome) -> dict[str, Any]:
        id, document = new_id(), fit.to_dict()
        self._results.write(id, document)
        summary = {
            "status": fit.status, "message": fit.message, "metrics": document["metrics"],
            "seconds": fit.seconds,
        }  # fmt: skip
        outcome.rows.append(
            ModelRow(
                id=id, created=time.time(), origin="fit", name=fit.spec.model.name,
                document=document["model"], table_id=job.table_id, job_id=job.id, summary=summary,
            )
        )  # fmt: skip
        return {
            "kind": "fit", "model": fit.spec.model.name, "id": id, "status": fit.status,
            "seconds": fit.seconds,
        }  # fmt: skip

    def _posterior(self, job: JobRow, table: fitter.Table, progress: Progress) -> Outcome:
        from fitter.fitting import FitResult
        from fitter.posterior import sample

        fit_id = str(job.request["fit"])
        fit = FitResult.from_dict(self._results.read(fit_id))
        spec, kept = posterior_spec(job.request["spec"]), self._results.checkpoint(job.id)
        try:
            posterior = sample(table, fit, spec, checkpoint=kept, progress=progress)
        except SpecError as error:
            if not error.code.startswith("checkpoint-"):
                raise
            # Of a server with other versions, or cut off by a full disk: nothing to hold against the job.
            self._results.drop_checkpoint(job.id)
            posterior = sample(table, fit, spec, checkpoint=kept, progress=progress)
        id = new_id()
        self._results.write(id, posterior.to_dict())
        summary = {"status": posterior.status, "message": posterior.message, "seconds": posterior.seconds}
        row = PosteriorRow(id=id, created=time.time(), fit_id=fit_id, job_id=job.id, summary=summary)
        result = {
            "kind": "posterior", "model": fit.spec.model.name, "id": id, "status": posterior.status,
            "seconds": posterior.seconds, "acceptance": posterior.acceptance,
        }  # fmt: skip
        return Outcome([row], [result])

    def _calibration(self, job: JobRow, table: fitter.Table, progress: Progress) -> Outcome:
        from fitter.calibration import calibrate
        from fitter.fitting import FitResult

        fit_id = str(job.request["fit"])
        fit = FitResult.from_dict(self._results.read(fit_id))
        found = calibrate(table, fit, calibration_spec(job.request["spec"]), progress=progress)
        id, picture = new_id(), found.picture("png")
        self._results.write(id, found.to_dict())
        self._results.write_report(id, "png", picture)
        summary = {"status": found.status, "message": found.message, "seconds": found.seconds}
        row = CalibrationRow(
            id=id, created=time.time(), fit_id=fit_id, job_id=job.id, summary=summary
        )  # fmt: skip
        name = fit.spec.model.name
        return Outcome([row], [{"kind": "calibration", "model": name, "id": id, "status": found.status}])

    def _scene(self, job: JobRow, progress: Progress) -> Outcome:
        from fitter.scene import picture as files
        from fitter.scene import plan, render
        from fitter.scene.layers import layers

        wanted = job.request
        scene = scene_of(wanted["scene"], self._store.get, self._tables)
        asked = {name: wanted[name] for name in ("seed", "precision", "tiles")}
        planned = plan(scene, progress=progress, **asked) if wanted["plan"] else None
        limits = {name: wanted[name] for name in ("samples", "seconds", "target_error", "seed", "precision")}
        found = render(scene, by=planned, progress=progress, **limits)
        if wanted["layers"]:
            found.layers.update(layers(scene, found, progress))
        document = found.to_dict()
        id = new_id()
        self._results.write(id, document)
        self._results.write_report(id, "exr", files.exr(found))
        self._results.write_report(id, "png", files.png(found))
        shown = ("width", "height", "samples", "seconds", "error", "stopped")
        summary = {name: document[name] for name in shown}
        row = SceneRow(id=id, created=time.time(), job_id=job.id, summary=summary)
        return Outcome([row], [{"kind": "scene", "id": id, "status": found.stopped}])

    def _tradeoff(self, job: JobRow, table: fitter.Table, progress: Progress) -> Outcome:
        from fitter.tradeoffs import tradeoff

        found = tradeoff(table, tradeoff_spec(job.request["spec"]), progress=progress)
        # Drawn here and not when somebody looks: a worker has the time, and the picture never changes.
        page, picture = found.html().encode(), found.picture("png")
        id = new_id()
        self._results.write(id, found.to_dict())
        self._results.write_report(id, "html", page)
        self._results.write_report(id, "png", picture)
        names = [model.name for model in found.spec.models]
        summary = {"models": names, "points": len(found.points), "seconds": found.seconds}
        row = TradeoffRow(
            id=id, created=time.time(), table_id=job.table_id, job_id=job.id, summary=summary
        )  # fmt: skip
        return Outcome([row], [{"kind": "tradeoff", "models": names, "id": id, "status": "done"}])
