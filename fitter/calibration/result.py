"""Calibration: ranks and coverage of many simulations, and whether they are what they should be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fitter.calibration import bands
from fitter.documents import read_document, write_bytes, write_document
from fitter.errors import SpecError
from fitter.spec import CalibrationSpec, FitSpec, calibration_spec, fit_spec

KIND = "brdf-fitter/calibration"
#: The label of the truth's log-likelihood, which has a rank and no interval.
LIKELIHOOD = "log-likelihood"
#: Fewer simulations than this say too little for a verdict.
ENOUGH = 40


@dataclass(frozen=True)
class Row:
    """One parameter: does its rank look uniform, do its intervals hold the truth?

    p : of the ranks, if they were uniform. covered : how many intervals hold the truth; None for the
    log-likelihood. Failed simulations count as the lowest rank and as not covered.
    """

    label: str
    p: float
    uniform: bool
    covered: int | None
    covers: bool | None


@dataclass(frozen=True)
class Calibration:
    """What a run of simulations found.

    labels : parameters, and the log-likelihood. ranks, covered : by simulation and label; None where it
    failed, ``failures`` saying how often and why. ranges : of the truths, in the parameters' own units.
    noise : "table" or "inferred".
    """

    spec: CalibrationSpec
    fit_spec: FitSpec
    noise: str
    labels: tuple[str, ...]
    ranks: tuple[Mapping[str, int] | None, ...]
    covered: tuple[Mapping[str, bool] | None, ...]
    failures: Mapping[str, int]
    ranges: Mapping[str, tuple[float, float]]
    table: Mapping[str, Any]
    seconds: float
    version: str

    @property
    def simulations(self) -> int:
        """How many were run."""
        return len(self.ranks)

    @property
    def failed(self) -> int:
        return sum(self.failures.values())

    @property
    def each(self) -> float:
        """The confidence of a single test, for all of them to pass together with ``spec.confidence``."""
        return bands.corrected(self.spec.confidence, 2 * len(self.labels) - 1)

    def of(self, label: str) -> list[int]:
        """The ranks of a label, failed simulations at the lowest."""
        return [0 if one is None else one[label] for one in self.ranks]

    @property
    def coverage_band(self) -> tuple[int, int]:
        """Between how many intervals of a parameter may hold the truth."""
        return bands.coverage_band(self.simulations, self.spec.level, self.each)

    def rows(self) -> list[Row]:
        """One for each label."""
        low, high = self.coverage_band
        found: list[Row] = []
        for label in self.labels:
            p = bands.p_value(self.of(label), self.spec.draws)
            count = None
            if label != LIKELIHOOD:
                count = sum(one is not None and one[label] for one in self.covered)
            within = None if count is None else low <= count <= high
            found.append(Row(label, p, p >= 1.0 - self.each, count, within))
        return found

    @property
    def status(self) -> str:
        """ "calibrated", "not_calibrated", or "too_few_simulations"."""
        if any(not row.uniform or row.covers is False for row in self.rows()):
            return "not_calibrated"
        return "calibrated" if self.simulations >= ENOUGH else "too_few_simulations"

    @property
    def message(self) -> str:
        """The status in a sentence."""
        rows, n = self.rows(), self.simulations
        shares = [row.covered / n for row in rows if row.covered is not None]
        low, high = self.coverage_band
        level = f"{100 * self.spec.level:g} %"
        text = (
            f"{n} simulations, {self.failed} failed; {level} intervals hold the truth in "
            f"{100 * min(shares):.1f} to {100 * max(shares):.1f} % of them"
        )
        bad = [row.label for row in rows if not row.uniform]
        missed = [row.label for row in rows if row.covers is False]
        if bad:
            text += f"; ranks are not uniform: {', '.join(bad)}"
        if missed:
            text += (
                f"; outside {100 * low / n:.1f} to {100 * high / n:.1f} %, which chance allows: "
                f"{', '.join(missed)}"
            )
        if not bad and not missed:
            text += ", as chance allows, and every rank looks uniform"
            if n < ENOUGH:
                text += f"; fewer than {ENOUGH} simulations see little"
        return text

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; what follows from the ranks is in it, too."""
        low, high = bands.ecdf_band(self.simulations, self.spec.draws, self.each)
        return {
            "kind": KIND, "version": 1, "spec": self.spec.model_dump(mode="json"),
            "fit_spec": self.fit_spec.model_dump(mode="json"), "noise": self.noise,
            "labels": list(self.labels),
            "ranks": [None if one is None else dict(one) for one in self.ranks],
            "covered": [None if one is None else dict(one) for one in self.covered],
            "failures": dict(self.failures), "ranges": {k: list(v) for k, v in self.ranges.items()},
            "table": dict(self.table), "seconds": self.seconds, "brdf_fitter": self.version,
            "simulations": self.simulations, "failed": self.failed, "status": self.status,
            "message": self.message,
            "rows": [vars(row) for row in self.rows()],
            "bands": {
                "confidence_of_each": self.each, "coverage": list(self.coverage_band),
                "ecdf_lowest": low.tolist(), "ecdf_highest": high.tolist(),
            },
        }  # fmt: skip

    @staticmethod
    def from_dict(document: Mapping[str, Any]) -> Calibration:
        """What :meth:`to_dict` wrote. Raises SpecError on anything else."""
        try:
            if document["kind"] != KIND or document["version"] != 1:
                raise KeyError(f"kind is {document['kind']!r}")
            return Calibration(
                spec=calibration_spec(document["spec"]), fit_spec=fit_spec(document["fit_spec"]),
                noise=document["noise"], labels=tuple(document["labels"]), ranks=tuple(document["ranks"]),
                covered=tuple(document["covered"]), failures=document["failures"],
                ranges={name: (float(a), float(b)) for name, (a, b) in document["ranges"].items()},
                table=document["table"], seconds=float(document["seconds"]), version=document["brdf_fitter"],
            )  # fmt: skip
        except (KeyError, TypeError, ValueError) as error:
            raise SpecError(
                f"this is not a calibration ({error})", code="not-a-calibration",
                remedy="give the file that `brdf-fitter calibrate --out` wrote",
            ) from error  # fmt: skip

    def picture(self, kind: str = "png") -> bytes:
        """Distribution functions of the ranks less the uniform one, with their bands; "png" or "svg"."""
        from fitter.calibration.picture import draw

        return draw(self, kind)

    def save(self, folder: Path | str) -> None:
        """Write calibration.json and calibration.png into ``folder``, each aside and renamed."""
        folder = Path(folder)
        drawn = self.picture("png")  # before the first file: no half of it after an error
        write_document(self.to_dict(), folder / "calibration.json")
        write_bytes(drawn, folder / "calibration.png")


def load_calibration(path: Path | str) -> Calibration:
    """Read the calibration.json that :meth:`Calibration.save` wrote."""
    return Calibration.from_dict(read_document(Path(path), "not-a-calibration"))
