"""What a worker does: read the tables of a unit, fit them, write their folders.

Everything is written aside and renamed, the unit's record last: a unit whose record is there is finished,
whatever became of the worker since.
"""

from __future__ import annotations

import functools
import logging
import shutil
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.batch import records
from fitter.batch.planning import TABLES, Unit, folder_names
from fitter.batch.specification import BatchSpec, batch_spec
from fitter.documents import write_document
from fitter.errors import FitterError
from fitter.memory_maps import forget_when_many
from fitter.progress import Cancelled

if TYPE_CHECKING:
    from fitter.fitting import FitResult
    from fitter.posterior import Posterior
    from fitter.table import Table

_log = logging.getLogger("brdf_fitter.batch")


@functools.cache
def start() -> None:
    """Get a worker process ready, once: JAX, and the folder that keeps its compiled programs."""
    from fitter import _jax

    _jax.start(_log.warning)


def work(
    unit: Mapping[str, Any], spec: Mapping[str, Any], key: str, out: str,
    share: tuple[int, int] | None = None, *, split: bool = False,
    told: Callable[[float], None] = lambda done: None,
) -> dict[str, Any]:  # fmt: skip
    """Do one unit and write its record to its folder. Arguments and result are plain data.

    share : (k, n): of a unit of several tables only every n-th from the k-th; the record is left to the
        caller.
    split : do nothing where the unit holds several tables, but say how many.
    told : called after each table with how much of the unit is done; what it raises ends the work.

    Returns ``failed``, and of a share the ``record`` and which tables it is of (``order``); or, where it is
    to be split, ``tables``, their number, and the ``seconds`` that reading them took.

    What goes wrong with a table, or with one model of it, is in the record: only that part failed. OSError
    where the disk is full: then nothing else will work either.
    """
    start()
    todo = Unit.from_dict(unit)
    asked = batch_spec(spec)
    folder = Path(out) / TABLES / todo.name
    begun = time.monotonic()
    (folder / records.RECORD).unlink(missing_ok=True)  # of an earlier attempt
    tables: list[dict[str, Any]] = []
    problem: dict[str, Any] | None = None
    order: list[int] = []
    try:
        opened = _opened(todo)
        if split and len(opened) > 1:
            return {"tables": len(opened), "seconds": time.monotonic() - begun}
        items = [str(table.metadata.provenance.get("item", k)) for k, table in enumerate(opened)]
        names = folder_names(items, records.RECORD)
        for k in range(len(opened)) if share is None else range(share[0], len(opened), share[1]):
            place = folder if len(opened) == 1 else folder / names[k]
            known = records.known(place, key) if len(opened) > 1 else None
            tables.append(known or _table(opened[k], place, asked, todo, Path(out)))
            order.append(k)
            if len(opened) > 1 and known is None:
                write_document({"key": key, "table": tables[-1]}, place / records.TABLE)
            told((k + 1) / len(opened))
    except Cancelled:
        raise
    except FitterError as error:
        problem = error.to_dict()
    except OSError:
        raise
    except Exception as error:  # one table's fault, whatever it is, must not end the others'
        traceback.print_exc()
        problem = {
            "code": "internal", "message": f"{type(error).__name__}: {error}", "file": todo.paths[0],
            "cause": "a fault of the program; the worker's output has the details", "remedy": "report it",
        }  # fmt: skip
    record = records.record_of(todo, key, time.monotonic() - begun, tables, problem)
    forget_when_many()
    if share is not None:
        return {"failed": records.failed(record), "record": record, "order": order}
    records.write_record(Path(out), record)
    return {"failed": records.failed(record)}


def count(unit: Unit) -> int:
    """Tables that the unit holds; 1 where it can't be read."""
    try:
        return len(_opened(unit))
    except Exception:  # told when it is its turn, as that table's fault
        return 1


def _opened(unit: Unit) -> list[Table]:
    from fitter.formats import archives, load_all
    from fitter.formats.source import Source

    options = dict(unit.reading)
    if unit.member is None:
        paths: Any = unit.paths[0] if len(unit.paths) == 1 else list(unit.paths)
        return load_all(paths, **options)
    path = Path(unit.paths[0])
    archive = Source(path)
    with archives.opened(archive, path) as content:
        members = [one for one in archives.files(content) if one.filename == unit.member]
        if not members:
            raise archive.error(
                "the archive has lost this member since the batch was planned", "archive-damaged",
                column=unit.member[:80], remedy="give the command again",
            )  # fmt: skip
        archives.refuse_large(archive, members)
        return load_all(archives.unpacked(archive, content, members[0]), **options)


def _table(table: Table, place: Path, spec: BatchSpec, unit: Unit, out: Path) -> dict[str, Any]:
    """Fit one table; what the summary says of it. Files of an earlier attempt go first."""
    from fitter.batch.pictures import draw
    from fitter.fitting.result import best

    begun = time.monotonic()
    if place.exists():
        shutil.rmtree(place)
    name = place.relative_to(out / TABLES).as_posix()
    source = _source(table, unit, alone=name == unit.name)
    described: dict[str, Any] = {
        "table": name,
        "folder": str(place.relative_to(out)), "path": unit.paths[0], "member": unit.member,
        "format": table.metadata.source_format, "sha256": table.metadata.sha256, "hash": table.hash,
        "samples": len(table), "usable": table.usable, "channels": [c.name for c in table.channels],
        "read_seconds": table.load_seconds, "fits": [], "notes": [],
    }  # fmt: skip
    results: list[FitResult] = []
    for model, found in _fits(table, spec):
        if isinstance(found, FitterError):
            described["fits"].append({"model": model, "error": found.to_dict()})
            continue
        found = found.with_source(source)
        found.save(place / found.spec.model.file_name)
        results.append(found)
        described["fits"].append(row_of(found))
    if results:
        chosen = best(results)
        described["best"] = chosen.spec.model.name
        posterior = None
        if spec.posterior is not None:
            posterior = _posterior(table, chosen, spec, place, described)
        draw(table, chosen, place)
        if spec.report:
            from fitter.report import complete

            others = [one for one in results if one is not chosen]
            complete(table, chosen, posterior, others=others).save(place)
        described["notes"] += _exported(chosen, spec.exports, place)
    described["seconds"] = time.monotonic() - begun
    return described


def _source(table: Table, unit: Unit, *, alone: bool) -> dict[str, Any]:
    """Where `posterior`, `report` and `export` find the table again: a file, or a folder or archive and which
    of its tables."""
    path, options = Path(unit.paths[0]), dict(unit.reading)
    if unit.member is not None or len(unit.paths) > 1 or not alone:
        options["item"] = str(table.metadata.provenance.get("item", table.metadata.name))
    return {"path": str(path if len(unit.paths) == 1 else path.parent), "options": options}


def _fits(table: Table, spec: BatchSpec) -> list[tuple[str, FitResult | FitterError]]:
    from fitter.fitting import fit
    from fitter.selection import select
    from fitter.spec import SelectionSpec

    if isinstance(spec.models, str):
        names = set(SelectionSpec.model_fields) & set(BatchSpec.model_fields)
        chosen = select(table, SelectionSpec(**{name: getattr(spec, name) for name in names}))
        return [(one.spec.model.name, one) for one in chosen.fits]
    found: list[tuple[str, FitResult | FitterError]] = []
    for model in spec.models:
        try:
            found.append((model.name, fit(table, spec.fit_spec(model))))
        except FitterError as error:
            found.append((model.name, error))
    return found


def row_of(result: FitResult) -> dict[str, Any]:
    """A fit as the summary has it."""
    document = result.to_dict()
    return {
        "model": result.spec.model.name, "file": result.spec.model.file_name, "status": result.status,
        "metric": result.table.get("metric"), "metrics": document["metrics"],
        "parameters": document["parameters"], "model_channels": list(result.model.channels),
        "seconds": result.seconds, "warnings": list(result.warnings),
    }  # fmt: skip


def _posterior(
    table: Table, fit: FitResult, spec: BatchSpec, place: Path, described: dict[str, Any]
) -> Posterior | None:
    from fitter.posterior import sample

    assert spec.posterior is not None
    kept = place.with_name(f".{place.name}.checkpoint")
    try:
        found = sample(table, fit, spec.posterior, checkpoint=kept)
    except FitterError as error:
        described["posterior"] = {"error": error.to_dict()}
        return None
    found.save(place / "posterior.json")
    if kept.exists():
        shutil.rmtree(kept)
    described["posterior"] = {
        "model": fit.spec.model.name, "status": found.status, "seconds": found.seconds,
        "intervals": found.intervals(), "warnings": list(found.warnings),
    }  # fmt: skip
    return found


def _exported(fit: FitResult, targets: Sequence[str], place: Path) -> list[dict[str, Any]]:
    """Write the exports; what they have to tell, and why one was refused."""
    from fitter import export

    notes: list[dict[str, Any]] = []
    for name in targets:
        entry = export.target(name)
        try:
            written = export.write(fit, name, place / f"{name}{entry.suffix}")
        except FitterError as error:
            notes.append({"export": name, "error": error.to_dict()})
            continue
        notes += [{"export": name, "code": note.code, "note": note.message} for note in written.notes]
    return notes
