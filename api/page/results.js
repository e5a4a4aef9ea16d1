// Results side by side: parameters with uncertainties; of the fit in focus what its report and posterior show.

import { card, el, fill, grid, number, percent, problem, seconds } from "./dom.js";
import { corner } from "./corner.js";
import { fitsOfJob } from "./fits.js";
import { front } from "./front.js";
import { bands, residualMaps } from "./report.js";
import { set } from "./state.js";

/** Show a finished job in a box; what is there already stays. */
export function results(box, job, now) {
  if (box.job !== job.id || !box.firstChild) {
    box.job = job.id;
    box.focused = null;
    fill(box, "Fetching the results …", async () => {
      const fits = await fitsOfJob(job, "fit");
      box.fits = fits;
      box.places = { focus: el("div", {}), front: el("div", {}) };
      const failed = job.results.filter((one) => one.kind === "fit" && one.problem);
      const selection = job.results.find((one) => one.kind === "selection");
      setTimeout(() => focus(box, job, now));
      return [
        el("h2", {}, "Results"), selection && chosenBy(selection), side(fits),
        ...failed.map((one) => problem({ document: { ...one.problem, title: `${one.model}: ${one.problem.title || "not fitted"}` } })),
        fits.length ? choice(fits, job, now) : null, box.places.focus, box.places.front,
      ].filter(Boolean);
    });
  } else if (box.fits) focus(box, job, now);
}

function chosenBy(selection) {
  const ranking = selection.ranking || [];
  return card("How the model was chosen", el("ul", {}, (selection.sentences || []).map((text) => el("li", {}, text))),
    grid("Candidates, the best first", ["model", "parameters", "median relative error", "judged on", "as good as the best"],
      ranking.map((one) => [one.model, number(one.parameters), percent(one.relative_error), one.held_out ? "samples held out" : "samples it was fitted to", one.as_good ? "yes" : "no"])));
}

/** A column for each fit. */
function side(fits) {
  const rows = [
    ["status", ...fits.map((fit) => fit.status)], ["metric", ...fits.map((fit) => fit.spec.metric || fit.table?.metric || "default")],
    ["relative rmse", ...fits.map((fit) => number(fit.metrics.relative_rmse, 3))], ["rmse / (1/sr)", ...fits.map((fit) => number(fit.metrics.rmse, 3))],
    ["R²", ...fits.map((fit) => number(fit.metrics.r2, 4))], ["time", ...fits.map((fit) => seconds(fit.cost.seconds))],
  ];
  const names = [...new Set(fits.flatMap((fit) => Object.keys(fit.parameters)))];
  for (const name of names) {
    const channels = Math.max(...fits.map((fit) => (Array.isArray(fit.parameters[name]?.value) ? fit.parameters[name].value.length : 1)));
    for (let c = 0; c < Math.min(channels, 8); c++) {
      const named = fits.find((fit) => fit.parameters[name]);
      const unit = named.parameters[name].unit;
      const label = `${name}${channels > 1 ? ` [${named.model.channels[c]}]` : ""}${unit && unit !== "1" ? ` / ${unit}` : ""}`;
      rows.push([el("span", { title: named.parameters[name].description }, label), ...fits.map((fit) => estimate(fit.parameters[name], c))]);
    }
  }
  return card("Side by side", grid("Estimates ± standard uncertainty u (k = 1)", ["", ...fits.map((fit) => fit.model.name)], rows),
    el("p", { class: "quiet" }, "u is that of the fit alone; the report adds scale, angles and what the model can't follow."));
}

function estimate(parameter, c) {
  if (!parameter) return "–";
  const at = (given) => (Array.isArray(given) ? (given.length > c ? given[c] : c ? undefined : given[0]) : c ? undefined : given);
  const value = at(parameter.value), u = at(parameter.standard_uncertainty), bound = at(parameter.at_bound);
  if (value === undefined) return "shared";
  return `${number(value, 4)}${u === null || u === undefined ? "" : ` ± ${number(u, 2)}`}${bound ? ` (at its ${bound} bound)` : ""}`;
}

/** The fit that somebody chose, or that "auto" did, or the one with the smallest relative error. */
function inFocus(fits, job, now) {
  const off = (fit) => fit.metrics.relative_rmse ?? Infinity;
  const auto = job.results.some((one) => one.kind === "selection");
  return fits.find((one) => one.id === now.fit) || (auto ? fits[0] : [...fits].sort((a, b) => off(a) - off(b))[0]);
}

function choice(fits, job, now) {
  const radios = fits.map((fit) => el("label", { class: "chip" }, el("input", {
    type: "radio", name: "focus", value: fit.id, checked: fit === inFocus(fits, job, now), onchange: () => set({ fit: fit.id, posterior: "" }),
  }), ` ${fit.model.name}`));
  return el("fieldset", { class: "row" }, el("legend", {}, "In focus"), radios);
}

function focus(box, job, now) {
  const fit = inFocus(box.fits, job, now);
  if (!fit) return;
  // The other panels and the link mean this one, too.
  if (!now.fit) set({ fit: fit.id });
  for (const radio of box.querySelectorAll("input[name=focus]")) radio.checked = radio.value === fit.id;
  if (box.focused !== fit.id) {
    box.focused = fit.id;
    const maps = el("div", {}), slices = el("div", {}), doubt = el("div", {});
    box.places.focus.replaceChildren(
      card(`Slices of data and fits, with the 95 % band of ${fit.model.name}`, slices), card("Residual maps, side by side", maps), card(`Posterior of ${fit.model.name}`, doubt));
    box.parts = { maps, slices, doubt };
  }
  bands(box.parts.slices, box.fits, fit, now);
  residualMaps(box.parts.maps, box.fits, now);
  corner(box.parts.doubt, fit, now);
  if (!box.places.front.firstChild) box.places.front.replaceChildren(card("Accuracy against time", el("div", {})));
  front(box.places.front.querySelector("section > div"), job, box.fits, fit, now);
}

