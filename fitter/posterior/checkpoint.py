"""Checkpoint: a folder that holds a run as far as it is, so that a killed one goes on where it was.

``run.json`` says which run it is, ``tuned.npz`` holds the tuned proposals, and each ``segment-NNNNN.npz`` the
steps since the one before with the walkers and the random states at its end. Every file is written aside and
renamed: a kill costs the steps since the last one, and the chain is the same to the last bit.
"""

from __future__ import annotations

import hashlib
import io
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fitter
from fitter.documents import read_document, write_bytes, write_document
from fitter.errors import SpecError
from fitter.fitting.result import FitResult
from fitter.posterior.blobs import Blobs
from fitter.posterior.ensembles import Ensembles, Proposal, Segment
from fitter.spec import PosteriorSpec, canonical_json
from fitter.table import Table
from fitter.versions import installed

KIND = "brdf-fitter/posterior-checkpoint"
#: What says when a run ends and what is kept of it, and nothing of its chain: a run that ended too early goes
#: on with other values of these.
ENDS = {"rhat", "ess", "budget_seconds", "keep", "draws"}
_REMEDY = "name another folder, or delete this one to begin anew"


@dataclass(frozen=True)
class Checkpoint:
    """The folder of the run with this digest (:func:`digest`)."""

    folder: Path
    digest: str

    def begin(self) -> None:
        """Claim the folder. Raises SpecError where it holds another run or something else."""
        about = self.folder / "run.json"
        if about.exists():
            found = read_document(about, "checkpoint-damaged")
            if found.get("digest") != self.digest:
                raise SpecError(
                    "this checkpoint belongs to another run", code="checkpoint-other-run",
                    file=str(self.folder), parameter="checkpoint",
                    cause="another table, fit, seed, setting or version", remedy=_REMEDY,
                )  # fmt: skip
        elif self.folder.exists() and (not self.folder.is_dir() or self._holds_something()):
            raise SpecError(
                "this is not a checkpoint", code="checkpoint-other-run", file=str(self.folder),
                parameter="checkpoint", remedy="name an empty folder, or one that is not there yet",
            )  # fmt: skip
        else:
            write_document({"kind": KIND, "version": 1, "digest": self.digest}, about)

    def _holds_something(self) -> bool:
        # What starts with a dot was being written aside by a run that was killed.
        return any(not path.name.startswith(".") for path in self.folder.iterdir())

    def restore(self, runs: Sequence[Ensembles]) -> float | None:
        """Put the runs where the checkpoint is; the seconds that were spent on them, or None where it holds
        nothing yet. Raises SpecError where a file of it is damaged."""
        if not (self.folder / "tuned.npz").exists():
            return None
        held = self._read("tuned.npz")
        count = len(list(self.folder.glob("segment-*.npz")))
        try:
            for k, run in enumerate(runs):
                found = None
                if f"blobs{k}_weight" in held:
                    found = Blobs(*(held[f"blobs{k}_{field}"] for field in Blobs._fields))
                run.proposal = Proposal(
                    held[f"mean{k}"], held[f"covariance{k}"], held[f"walkers{k}"], found
                )  # fmt: skip
                run.density = replace(run.density, centre=held[f"centre{k}"])
                run.tuning = int(held[f"steps{k}"])
            for number in range(count):
                held = self._read(f"segment-{number:05d}.npz")
                for k, run in enumerate(runs):
                    chain, place = held[f"chain{k}"], held[f"place{k}"]
                    random = (held[f"keys{k}"], int(place[0]), int(place[1]), float(held[f"normal{k}"]))
                    run.segments.append(
                        Segment(chain, held[f"log_density{k}"], float(held[f"accepted{k}"]), random)
                    )
        except KeyError as error:
            raise self._damaged(str(error)) from error
        return float(held["seconds"])

    def tuned(self, runs: Sequence[Ensembles], seconds: float) -> None:
        """Keep the tuned proposals."""
        parts: dict[str, Any] = {"seconds": seconds}
        for k, run in enumerate(runs):
            mean, covariance, walkers, found = run.proposal
            parts |= {f"mean{k}": mean, f"covariance{k}": covariance, f"walkers{k}": walkers}
            if found is not None:
                parts |= {f"blobs{k}_{field}": part for field, part in found._asdict().items()}
            parts |= {f"centre{k}": run.density.centre, f"steps{k}": run.tuning}
        self._write("tuned.npz", parts)

    def extend(self, runs: Sequence[Ensembles], seconds: float) -> None:
        """Keep the latest segment of every run."""
        parts: dict[str, Any] = {"seconds": seconds}
        for k, run in enumerate(runs):
            chain, log_density, accepted, (keys, position, has_normal, normal) = run.segments[-1]
            parts |= {f"chain{k}": chain, f"log_density{k}": log_density, f"accepted{k}": accepted}
            parts |= {f"keys{k}": keys, f"place{k}": [position, has_normal], f"normal{k}": normal}
        self._write(f"segment-{len(runs[0].segments) - 1:05d}.npz", parts)

    def remove(self) -> None:
        shutil.rmtree(self.folder)

    def _write(self, name: str, parts: dict[str, Any]) -> None:
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **parts)
        write_bytes(content.getvalue(), self.folder / name)

    def _read(self, name: str) -> dict[str, NDArray[Any]]:
        try:
            with np.load(io.BytesIO((self.folder / name).read_bytes()), allow_pickle=False) as held:
                return dict(held)
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise self._damaged(f"{name}: {error}") from error

    def _damaged(self, what: str) -> SpecError:
        return SpecError(
            f"this checkpoint can't be read ({what})", code="checkpoint-damaged", file=str(self.folder),
            parameter="checkpoint", remedy=_REMEDY,
        )  # fmt: skip


def digest(
    table: Table, fit: FitResult, request: PosteriorSpec, within: Mapping[str, tuple[float, float]]
) -> str:  # fmt: skip
    """sha256 of everything that the chain of a run depends on."""
    found = hashlib.sha256()
    settings = request.model_copy(update={name: PosteriorSpec.model_fields[name].default for name in ENDS})
    libraries = [installed(name) for name in ("numpy", "scipy", "jax", "emcee")]
    specs = [canonical_json(one) for one in (settings, fit.spec)]
    for text in (fitter.__version__, *libraries, *specs, table.hash):
        found.update(text.encode() + b"\n")
    found.update(repr((table.metadata.angle_uncertainty, fit.model.channels)).encode())
    for name, estimate in fit.parameters.items():
        found.update(name.encode() + np.ascontiguousarray(estimate.value).tobytes())
    found.update(repr((fit.metrics.get("relative_rmse"), sorted(within.items()))).encode())
    return found.hexdigest()
