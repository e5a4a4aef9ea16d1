"""The PDF of a report: A4 pages drawn from its record, for files that outlive a browser."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fitter.report import figures, figures_posterior
from fitter.report.page import facts, number, share, source, whole
from fitter.report.paper import Paper
from fitter.report.plane import spread

Record = Mapping[str, Any]
COLOURS = {"good": "#1a7f37", "caution": "#9a6700", "bad": "#b42318"}
SOFT = "#555555"
#: Sources of uncertainty at the head of a narrow column.
SHORT = {"theta_i": "θ_i", "theta_o": "θ_o", "phi": "φ", "discrepancy": "discrep."}
#: Rows of the BRDF's uncertainty that a page shows; the record has all.
MOST_BRDF = 18


def render(record: Record) -> bytes:
    """One PDF document."""
    hash_ = str(record["provenance"]["fitted_table_hash"] or record["provenance"]["table_hash"])
    paper = Paper(str(record["title"]), f"{record['title']} · table {hash_[:12]} · {record['created']}")
    for part in (
        _verdict, _parameters, _budget, _propagation, _residuals, _slices, _reflectance, _correlation,
        _posterior, _comparison, _cost, _provenance,
    ):  # fmt: skip
        part(paper, record)
    return paper.bytes()


def _verdict(paper: Paper, record: Record) -> None:
    verdict, fit = record["verdict"], record["fit"]
    version = record["provenance"]["report_versions"]["brdf-fitter"]
    paper.heading(str(record["title"]), 18)
    paper.text(
        f"Fit of a reflectance model to a measured BRDF table · brdf-fitter {version} · {record['created']}",
        colour=SOFT,
    )
    paper.heading(verdict["headline"], 13, COLOURS[verdict["level"]])
    for k, sentence in enumerate(verdict["sentences"], start=1):
        paper.text(f"{k}. {sentence}", 10)
    for limit in verdict["limits"]:
        paper.text(limit, colour=SOFT)
    if verdict["reasons"]:
        paper.heading("What to know before using it", 11)
        for reason in verdict["reasons"]:
            paper.text(f"– {reason}", indent=0.1)
    notes = [*record["warnings"], *record["table"]["notes"]]
    if notes:
        paper.heading("Warnings and notes", 11)
        for note in notes:
            paper.text(f"– {note}", indent=0.1)
    posterior = record["posterior"]
    paper.table(
        ("status", "relative rmse", "R²", "samples", "scans", "largest R-hat", "seconds"),
        [[
            fit["status"].replace("_", " "), share(fit["metrics"].get("relative_rmse")),
            number(fit["metrics"].get("r2")), number(fit["samples"]),
            number(record["table"]["domain"]["incidences"]),
            number(posterior["largest_rhat"], 4) if posterior else "no posterior", number(fit["seconds"], 2),
        ]],
    )  # fmt: skip


def _parameters(paper: Paper, record: Record) -> None:
    section, posterior = record["parameters"], record["posterior"]
    paper.heading("Parameters")
    paper.text(
        "Estimate y, standard uncertainty u (k = 1), expanded uncertainty U = k u that covers with "
        f"{100 * section['coverage_probability']:g} %. The "
        f"fit's part of u: {section['kind_in_words']}. {section['meaning']} A dash: none can be stated."
    )
    head = ["parameter", "state", "unit", "y", "u", "k", "U"]
    rows: list[list[str]] = []
    for row in section["rows"]:
        text = row["text"]
        line = [row["display"], row["state"], row["unit"], text["estimate"], text["standard_uncertainty"]]
        line += [text["factor"], text["expanded_uncertainty"]]
        if posterior:
            own = row["posterior"]
            line += ["—", "—"] if own is None else [
                own["text"]["median"], f"{own['text']['lower']} to {own['text']['upper']}"
            ]  # fmt: skip
        rows.append(line)
    paper.table(head + (["median", "95 % credible"] if posterior else []), rows, left=3)


def _budget(paper: Paper, record: Record) -> None:
    section = record["budget"]
    paper.heading("Uncertainty budget")
    names = [str(one["source"]) for one in section["sources"]]
    paper.table(
        ["parameter", *(SHORT.get(name, name) for name in names), "u", "ν", "k", "U", "95 % interval"],
        [
            [
                row["display"], *(row["components"][name]["text"] for name in names), row["text"]["combined"],
                row["text"]["freedom"], row["text"]["factor"], row["text"]["expanded"],
                f"{row['text']['lower']} to {row['text']['upper']}",
            ]
            for row in section["rows"]
        ],
    )  # fmt: skip
    for one in section["sources"]:
        size = one["standard_uncertainty"]
        known = f", u = {number(size, 2)} {one['unit']}" if one["unit"] and size is not None else ""
        missing = "" if one["stated"] else ": not stated, in none of these numbers"
        paper.text(f"{source(one['source'])} (type {one['type']}): {one['words']}{known}{missing}", 8, SOFT)
    with_unit = [one for one in section["sources"] if one["unit"]]
    paper.heading("Sensitivity coefficients", 11)
    paper.table(
        ["change of the estimate", *(f"per {one['unit']} of {source(one['source'])}" for one in with_unit)],
        [
            [row["display"], *(number(row["components"][one["source"]]["sensitivity"]) for one in with_unit)]
            for row in section["rows"]
        ],
    )
    robust = record["robust"]
    if robust is not None:
        paper.heading("Robust uncertainties", 11)
        paper.text(f"Found {robust['method_in_words']}; k = {number(robust['coverage_factor'])}.")
        paper.table(
            ["parameter", "y", "u, residuals independent", "u, robust", "ratio", "95 % interval"],
            [
                [
                    row["display"], row["text"]["estimate"], row["text"]["fit"],
                    row["text"]["standard_uncertainty"], number(row["ratio"], 2),
                    f"{row['text']['lower']} to {row['text']['upper']}",
                ]
                for row in robust["rows"]
            ],
        )  # fmt: skip


def _propagation(paper: Paper, record: Record) -> None:
    section = record["propagation"]
    if not section or not section["brdf"]:
        return
    paper.heading("Uncertainty of the BRDF and of the reflectance")
    paper.text(
        f"Combined uncertainty of the parameters, propagated linearly (GUM) and by {section['draws']} draws "
        f"(JCGM 101, 102); {share(section['validated'])} of these are validated within the tolerance δ."
    )
    rows = section["reflectance"] + [section["brdf"][k] for k in spread(len(section["brdf"]), MOST_BRDF)]
    paper.table(
        ["quantity", "channel", "θ_i (deg)", "θ_o (deg)", "value", "u, linear", "u, Monte Carlo", "δ",
         "validated"],
        [
            [
                "f (1/sr)" if "theta_o_deg" in row else "reflectance", row["channel"],
                f"{row['theta_i_deg']:g}", f"{row['theta_o_deg']:g}" if "theta_o_deg" in row else "all",
                number(row["estimate"], 4), number(row["linear"], 2), number(row["monte_carlo"], 2),
                number(row["delta"], 1), "yes" if row["validated"] else "no",
            ]
            for row in rows
        ],
        left=2,
    )  # fmt: skip


def _residuals(paper: Paper, record: Record) -> None:
    section = record["residuals"]
    paper.heading("Residuals against angle", room=3.0)
    paper.text(f"Relative residual = {section['definition']}. Medians in bins, bands the central 90 %.")
    paper.pictures([*figures.residual_pictures(record), *figures.map_pictures(record)])
    paper.table(
        ["channel", "median f (1/sr)", "rmse (1/sr)", "relative rmse", "Birge ratio", "systematic share"],
        [
            [
                row["channel"], number(row["median_value"]), number(row["rmse"]), share(row["relative_rmse"]),
                number(row["birge_ratio"], 2), share(row["systematic_share"]),
            ]
            for row in section["per_channel"]
        ],
    )  # fmt: skip


def _slices(paper: Paper, record: Record) -> None:
    section = record["slices"]
    if not section["slices"]:
        return
    paper.heading("In-plane slices", room=3.0)
    bands = "" if section["predictive_level"] is None else (
        " The light band is where a new measurement would fall with 95 % probability, the model's misfit "
        "included."
    )  # fmt: skip
    paper.text(f"Markers: measured; lines: the fit; dashed: the specular direction.{bands}")
    paper.pictures(figures.slice_pictures(record))


def _reflectance(paper: Paper, record: Record) -> None:
    section = record["reflectance"]
    paper.heading("Directional-hemispherical reflectance of the model", room=3.0)
    paper.pictures([figures.reflectance_picture(record)])
    paper.table(
        ["incidence", "energy", "θ_i (deg)", *section["channels"]],
        [
            [
                "extrapolated" if row["extrapolated"] else "measured",
                "above 1" if row["above_one"] else "conserved", f"{row['theta_i_deg']:g}",
                *(number(v) for v in row["reflectance"]),
            ]
            for row in section["rows"]
        ],
        left=2,
    )  # fmt: skip


def _correlation(paper: Paper, record: Record) -> None:
    section, joint = record["correlation"], record["budget"]["joint"]
    if len(section["labels"]) < 2:
        return
    paper.heading("Correlation and joint region", room=3.0)
    for text in [*section["not_separable"], *section["correlated"]]:
        paper.text(f"– {text}", indent=0.1)
    if joint:
        paper.text(
            f"The joint 95 % region of {joint['parameters']} parameters has a Mahalanobis radius of "
            f"{number(joint['mahalanobis_radius'], 4)}; the ellipse is that of {joint['a']} and {joint['b']}."
        )
    paper.pictures([figures.correlation_picture(record), figures_posterior.joint_picture(record)])


def _posterior(paper: Paper, record: Record) -> None:
    section = record["posterior"]
    paper.heading("Posterior and its convergence")
    if section is None:
        paper.text("No posterior was sampled.")
        return
    status = section["status"].replace("_", " ")
    told = section["message"] if section["message"].startswith(status) else f"{status}: {section['message']}"
    paper.text(f"{told[:1].upper()}{told[1:]}. {section['caveat']}")
    paper.pictures([figures_posterior.corner_picture(record)], across=1, tallest=5.2)
    paper.pictures(figures_posterior.convergence_pictures(record))
    paper.table(
        ["parameter", "R-hat", "ESS, bulk", "ESS, tail", "autocorrelation time"],
        [
            [
                label, number(d["rhat"], 5), whole(d["ess_bulk"]), whole(d["ess_tail"]),
                number(d["autocorrelation_time"]),
            ]
            for label, d in section["diagnostics"].items()
        ],
    )  # fmt: skip
    for warning in section["warnings"]:
        paper.text(f"– {warning}", indent=0.1)


def _comparison(paper: Paper, record: Record) -> None:
    if len(record["comparison"]) < 2:
        return
    paper.heading("Comparison of models")
    paper.table(
        ["model", "metric", "status", "free parameters", "relative rmse", "R²", "seconds"],
        [
            [
                row["model"], row["metric"], row["status"].replace("_", " "), str(row["parameters"]),
                share(row["metrics"].get("relative_rmse")), number(row["metrics"].get("r2")),
                number(row["seconds"], 2),
            ]
            for row in record["comparison"]
        ],
        left=3,
    )  # fmt: skip


def _cost(paper: Paper, record: Record) -> None:
    paper.heading("What it cost")
    _facts(paper, record["cost"]["cost"])


def _provenance(paper: Paper, record: Record) -> None:
    section = record["provenance"]
    paper.heading("Provenance")
    for command in section["commands"]:
        paper.text(command, 8)
    kept = {
        "hash of the fitted table": section["fitted_table_hash"],
        "sha256 of the file": section["file_sha256"],
    }
    for name, text in kept.items():
        paper.text(f"{name}: {text or '—'}", 8)
    _facts(paper, {"seeds": section["seeds"], "versions of the fit": section["versions"]})
    paper.text("Every number and figure here is drawn from the record, report.json.", 8, SOFT)


def _facts(paper: Paper, mapping: Record) -> None:
    """Everything in a nested mapping, run together."""
    paper.text(" · ".join(f"{name}: {text}" for name, text in facts(mapping)), 8)
