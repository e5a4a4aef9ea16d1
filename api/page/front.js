// What accuracy costs in time on this table, and where the fit in focus stands.

import { el, field, fill, percent, seconds } from "./dom.js";
import { start } from "./events.js";
import { given } from "./fits.js";
import { get, recordStarted } from "./http.js";
import { COLOURS, MARKS, draw, figure, scaledAxis } from "./plots.js";
import { watchJob } from "./progress.js";
import { scale } from "./scales.js";
import { set, state } from "./state.js";

export function front(box, job, fits, fit, now) {
  const here = JSON.stringify([job.id, fit.id, now.tradeoff]);
  if (box.here === here) return;
  box.here = here;
  fill(box, now.tradeoff ? "Fetching the front …" : "", async () => (now.tradeoff ? shown(now.tradeoff, fit) : asking(box, job, fits)));
}

function asking(box, job, fits) {
  const limit = el("input", { type: "number", min: "1", max: "3600", step: "any", value: "30" });
  const progress = el("div", {});
  const send = (event) => {
    event.preventDefault();
    fill(progress, "Starting …", async () => {
      const wanted = { table: job.table, models: fits.map((one) => one.spec.model), time_limit_seconds: Number(limit.value), posterior: false };
      const done = await watchJob(progress, await start("tradeoffs", wanted, "fit"), "accuracy against time");
      // Unless another job or table is shown by now.
      if (box.isConnected && state().table === job.table) set({ tradeoff: done.results[0].id });
    });
  };
  return el("form", { onsubmit: send },
    el("p", { class: "quiet" }, "Not measured yet: each of these models is fitted at several efforts, and judged on samples held out."),
    el("div", { class: "controls" }, field("Time limit / s", limit), el("div", { class: "field" }, el("button", { type: "submit", class: "main" }, "Measure it"))), progress);
}

async function shown(id, fit) {
  const found = await get(`/v1/tradeoffs/${id}`, { panel: "fit" });
  const job = await get(found.links.job);
  recordStarted("fit", "/v1/tradeoffs", [{ table: job.table, ...given(job.request.spec) }]);
  const points = found.points.filter((point) => point.settings.solver && point.errors.held_out !== null && point.seconds.median > 0);
  const { figure: made, box: plot } = figure("Each point is a fit at one effort; the line is the front");
  setTimeout(() => drawn(plot, points, fit));
  const chosen = points.find((point) => isOf(point, fit));
  return [
    made,
    el("p", {}, chosen
      ? `The fit in focus, ${fit.model.name}, is the ringed point: ${percent(chosen.errors.held_out)} off on samples held out, in ${seconds(chosen.seconds.median)}, compiled${chosen.front.includes("held_out/seconds") ? "; nothing measured is both faster and better" : "; something measured is faster and no worse"}.`
      : `No point was measured at the settings of the fit in focus, ${fit.model.name}.`),
    el("p", { class: "quiet" }, [found.noise?.sentence, found.skipped.length ? `Not measured in the time: ${found.skipped.length} settings` : ""].filter(Boolean).join(". ")),
  ];
}

/** Whether a point has the settings of a fit. */
function isOf({ model, settings }, { spec, model: { name } }) {
  return model === name && ["subset", "starts", "solver", "polish"].every((one) => settings[one] === spec[one]) && !settings.tolerance;
}

async function drawn(plot, points, fit) {
  const models = [...new Set(points.map((point) => point.model))];
  const off = (point) => 100 * point.errors.held_out;
  const wide = (values) => scale("log", values.flatMap((v) => [v / 1.5, v * 1.5]));
  const across = wide(points.map((point) => point.seconds.median)), up = wide(points.map(off));
  const placed = (some) => ({ x: some.map((point) => across.at(point.seconds.median)), y: some.map((point) => up.at(off(point))) });
  const traces = models.map((model, k) => {
    const own = points.filter((point) => point.model === model);
    return {
      type: "scatter", mode: "markers", name: model, ...placed(own), marker: { color: COLOURS[k % 7], symbol: MARKS[k % 7], size: 9 },
      hovertext: own.map((point) => `${point.label}<br>${seconds(point.seconds.median)}, ${percent(point.errors.held_out)}`), hoverinfo: "text",
    };
  });
  const best = points.filter((point) => point.front.includes("held_out/seconds")).sort((a, b) => a.seconds.median - b.seconds.median);
  traces.unshift({ type: "scatter", mode: "lines", name: "front", ...placed(best), line: { color: "#888888", shape: "hv", dash: "dot" }, hoverinfo: "skip" });
  const chosen = points.filter((point) => isOf(point, fit));
  if (chosen.length) traces.push({ type: "scatter", mode: "markers", name: "in focus", ...placed(chosen), marker: { symbol: "circle-open", size: 20, color: COLOURS[1], line: { width: 2.5 } }, hoverinfo: "skip" });
  await draw(plot, traces, {
    xaxis: scaledAxis(across, "time of a fit, compiled / s"), yaxis: scaledAxis(up, "relative error held out / %"), showlegend: true,
  }, `Error on samples held out against the time of a fit, ${points.length} points of ${models.join(", ")}.`);
}
