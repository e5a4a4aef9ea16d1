"""The first screen: can I trust this fit, in three sentences with numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from fitter.report.rounding import percent, significant

Record = Mapping[str, Any]

HEADLINES = {
    "good": "This fit can be used, within the uncertainties stated here.",
    "caution": "This fit can be used with care.",
    "bad": "Do not rely on this fit.",
}
#: Relative rmse from which on the model misses the table so much that it must be said.
LARGE_MISFIT, USELESS_MISFIT = 0.2, 1.0
#: Birge ratio from which on the stated noise does not explain the residuals.
LARGE_BIRGE = 2.0
#: R squared below which the model explains little.
LITTLE_EXPLAINED = 0.5
#: Systematic share of the residual variance from which on independent noise is no description of it.
MOSTLY_SYSTEMATIC = 0.5
MOST_NAMED = 6


def section(record: Record) -> dict[str, Any]:
    """The verdict, drawn from the other sections of the record."""
    bad, caution = _against(record)
    level = "bad" if bad else "caution" if caution else "good"
    return {
        "level": level,
        "headline": HEADLINES[level],
        "sentences": [_misfit(record), _parameters(record), *_robust(record), _posterior(record)],
        "reasons": [*bad, *caution],
        "limits": _limits(record),
        "thresholds": {"relative_rmse": LARGE_MISFIT, "birge_ratio": LARGE_BIRGE},
    }


def _limits(record: Record) -> list[str]:
    """What the stated uncertainties refer to, and what they leave out."""
    found = [record["parameters"]["meaning"]]
    share = _systematic(record)
    if share is not None and share > MOSTLY_SYSTEMATIC:
        text = (
            "Most of the residual is systematic. u and the credible intervals take it for noise that is "
            "independent from sample to sample, and are then too small, typically several times"
        )
        known = record["robust"] is not None
        found.append(f"{text}: rely on the robust uncertainties instead." if known else f"{text}.")
    if record["parameters"]["scale_uncertainty"] is None:
        found.append(
            "The table states no scale uncertainty: a calibration error common to all of it is not in u."
        )
    return found


def _against(record: Record) -> tuple[list[str], list[str]]:
    """What speaks against the fit, and what asks for care."""
    fit, posterior, rows = record["fit"], record["posterior"], record["parameters"]["rows"]
    bad: list[str] = []
    caution: list[str] = []
    if fit["status"] == "not_converged":
        bad.append(f"The fit did not converge: {_stop(fit['message'])}")
    elif fit["status"] != "converged":
        bad.append(f"{_capital(fit['status'].replace('_', ' '))}: {_stop(fit['message'])}")
    relative = fit["metrics"].get("relative_rmse")
    if relative is None:
        bad.append("The relative misfit is not a finite number.")
    elif relative > USELESS_MISFIT:
        bad.append(
            "The model misses the table by more than the values themselves "
            f"({percent(relative)} relative rmse)."
        )
    elif relative > LARGE_MISFIT:
        caution.append(
            f"The model misses the table by {percent(relative)} (relative rmse; more than "
            f"{percent(LARGE_MISFIT)} asks for care)."
        )
    r2 = fit["metrics"].get("r2")
    if r2 is not None and r2 < 0:
        bad.append(f"A constant would describe the table better than this model (R² = {significant(r2, 3)}).")
    elif r2 is not None and r2 < LITTLE_EXPLAINED:
        caution.append(f"The model explains little of the variance of f_r (R² = {significant(r2, 2)}).")
    birge = _birge(record)
    if birge is not None and birge > LARGE_BIRGE:
        text = f"The residuals are {significant(birge, 2)} times the stated measurement uncertainty"
        if fit["uncertainty"] == "curvature":
            text += ": the fit's part of u, which trusts it, is too small by at least about this factor"
        caution.append(text + ".")
    for state in ("on its lower bound", "on its upper bound"):
        labels = [row["display"] for row in rows if row["state"] == state]
        if labels:
            verb = "lies" if len(labels) == 1 else "lie"
            bound = state.removeprefix("on its ")
            caution.append(
                f"{_listed(labels)} {verb} on the {bound}: no symmetric uncertainty can be stated."
            )
    barely = [row["display"] for row in rows if row["barely_determined"]]
    if barely:
        caution.append(
            f"{_listed(barely)} {_be(barely)} barely determined (u is more than half the estimate)."
        )
    caution += record["correlation"]["not_separable"]
    if posterior is not None and posterior["status"] != "converged":
        caution.append(f"The posterior {_ended(posterior)}: {_stop(posterior['message'])}")
    high = [row["theta_i_deg"] for row in record["reflectance"]["rows"] if row["above_one"]]
    if high:
        inside = any(row["above_one"] and not row["extrapolated"] for row in record["reflectance"]["rows"])
        caution.append(
            f"The model reflects more than arrives at θ_i = {', '.join(f'{a:g}°' for a in high)}"
            + ("." if inside else ", outside the measured incidences.")
        )
    selection = record["selection"]
    if selection is not None and selection["verdict"] == "raw_table":
        caution.append(selection["sentences"][1])
    if selection is not None and selection["chosen"] != fit["model"]:
        caution.append(f"The comparison of models chose {selection['chosen']}, not {fit['model']}.")
    if record["table"]["mismatch"]:
        bad.insert(0, record["table"]["mismatch"])
    return bad, caution


def _misfit(record: Record) -> str:
    fit = record["fit"]
    status = {"converged": "converged", "not_converged": "did not converge"}.get(
        fit["status"], f"ended as {fit['status'].replace('_', ' ')}"
    )
    relative, r2 = (fit["metrics"].get(name) for name in ("relative_rmse", "r2"))
    channels = len(fit["channels"])
    text = (
        f"The fit of {fit['model']} (metric {fit['metric']}) {status}; over {fit['samples']:,} samples"
        f"{f' in {channels} channels' if channels > 1 else ''} the model misses the measured values by "
        f"{percent(_number(relative))} (relative rmse; R² = {significant(_number(r2), 3)})"
    )
    birge = _birge(record)
    if birge is not None:
        text += f", {significant(birge, 2)} times the stated uncertainty (Birge ratio of the worst channel)"
    share = _systematic(record)
    if share is not None:
        text += (
            f"; at least {percent(share)} of the residual variance is systematic misfit of the model, "
            "not noise"
        )
    return text + "."


def _parameters(record: Record) -> str:
    parameters = record["parameters"]
    free = [row for row in parameters["rows"] if row["state"] != "fixed"]
    fixed = len(parameters["rows"]) - len(free)
    stated = [row for row in free if row["standard_uncertainty"] is not None and row["state"] == "estimated"]
    open_ = [row["display"] for row in free if row["state"] == "not identified"]
    bound = [row["display"] for row in free if row["state"].startswith("on its")]
    parts: list[str] = []
    if len(stated) == len(free):
        every = "the free parameter is" if len(free) == 1 else f"all {len(free)} free parameters are"
        known = f"{_capital(every)} determined by the table and inside the bounds"
        parts.append(known if free else "No parameter was free")
    else:
        parts.append(f"{len(stated)} of {len(free)} free parameters have a standard uncertainty")
        if bound:
            parts.append(f"{_listed(bound)} {'lies' if len(bound) == 1 else 'lie'} on a bound")
        if open_:
            parts.append(f"{_listed(open_)} {_be(open_)} not identified by this table")
    if fixed:
        parts.append(f"{fixed} {'is' if fixed == 1 else 'are'} fixed")
    shares = [(row["standard_uncertainty"] / abs(row["estimate"]), row) for row in stated if row["estimate"]]
    if shares:
        _, worst = max(shares, key=lambda pair: pair[0])
        text = worst["text"]
        parts.append(
            f"the least well known is {worst['display']}, estimate y = {text['estimate']} with standard "
            f"uncertainty u = {text['standard_uncertainty']} and expanded uncertainty U = k u = "
            f"{text['expanded_uncertainty']} (k = {text['factor']})"
        )
    return "; ".join(parts) + "."


def _robust(record: Record) -> list[str]:
    """By how much the uncertainties grow when the residuals of a scan are taken to belong together."""
    found = record["robust"]
    if found is None or found["median_ratio"] is None:
        return []
    worth = min(found["effective_samples"].values())
    times = significant(found["median_ratio"], 2)
    text = (
        f"Residuals of neighbouring directions belong together ({record['fit']['samples']:,} samples are "
        f"worth about {significant(worth, 2)} independent ones): the robust standard uncertainties are "
        f"{times} times those of the fit, in the median"
    )
    if found["scans"]:
        text += f", by leaving out {found['words']}"
    if resting := found["resting"]:
        text += f"; {_listed(resting)} {'rests' if len(resting) == 1 else 'rest'} on one scan"
    return [text + "."]


def _posterior(record: Record) -> str:
    posterior = record["posterior"]
    if posterior is None:
        return (
            "No posterior was sampled: there are no credible intervals, and the uncertainties rest on the "
            "fit alone."
        )
    sizes = [posterior[name] for name in ("smallest_ess_bulk", "smallest_ess_tail")]
    ess = "—" if None in sizes else f"{min(sizes):,.0f}"
    numbers = f"largest R-hat {_rhat(posterior['largest_rhat'])}, smallest effective sample size {ess}"
    if posterior["status"] == "converged":
        return (
            f"The posterior converged ({numbers}); its 95 % intervals are credible intervals under the "
            "stated likelihood."
        )
    return f"The posterior {_ended(posterior)} ({numbers}): {_stop(posterior['message'])}"


def _ended(posterior: Mapping[str, Any]) -> str:
    words = {
        "not_identified": "does not identify every parameter",
        "prior_conflict": "is held off by the bounds it was given",
    }
    return words.get(posterior["status"], "did not converge")


def _birge(record: Record) -> float | None:
    """The largest Birge ratio of the channels."""
    return max(_known(record, "birge_ratio"), default=None)


def _systematic(record: Record) -> float | None:
    """The median systematic share of the channels."""
    found = sorted(_known(record, "systematic_share"))
    return found[len(found) // 2] if found else None


def _known(record: Record, name: str) -> list[float]:
    """A number of the channels that have it."""
    return [row[name] for row in record["residuals"]["per_channel"] if row[name] is not None]


def _listed(labels: Sequence[str]) -> str:
    if len(labels) > MOST_NAMED:
        return f"{', '.join(labels[:MOST_NAMED])} and {len(labels) - MOST_NAMED} more"
    return " and ".join([", ".join(labels[:-1]), labels[-1]] if len(labels) > 1 else labels)


def _be(labels: Sequence[str]) -> str:
    return "is" if len(labels) == 1 else "are"


def _number(x: float | None) -> float:
    return math.nan if x is None else x


def _rhat(x: float | None) -> str:
    return "—" if x is None else f"{x:.4f}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _stop(text: str) -> str:
    return text if text.endswith((".", "?", "!")) else text + "."
