// The posterior of a fit: sampled when asked for, shown as a corner plot.

import { el, facts, field, fill, grid, number, select } from "./dom.js";
import { start } from "./events.js";
import { get, recordStarted } from "./http.js";
import { COLOURS, draw, figure } from "./plots.js";
import { watchJob } from "./progress.js";
import { set, state } from "./state.js";

/** Parameters that are shown at once, and bins along each. */
const MOST = 6, BINS = 32;

export function corner(box, fit, now) {
  const id = now.posterior || fit.posteriors[0] || "";
  const here = JSON.stringify([fit.id, id, now.channel]);
  if (box.here === here) return;
  box.here = here;
  fill(box, id ? "Fetching the posterior …" : "", async () => (id ? shown(id, fit, now) : asking(box, fit, now)));
}

function asking(box, fit, now) {
  const budget = el("input", { type: "number", min: "1", max: "3600", step: "any", value: "20" });
  const ess = el("input", { type: "number", min: "10", max: "100000", step: "1", value: "400" });
  const progress = el("div", {});
  const send = (event) => {
    event.preventDefault();
    fill(progress, "Starting …", async () => {
      const job = await start("posteriors", { fit: fit.id, ess: Number(ess.value), budget_seconds: Number(budget.value) }, "fit");
      const done = await watchJob(progress, job, `posterior of ${fit.model.name}`);
      const { id } = done.results[0];
      fit.posteriors.unshift(id);
      // Unless another fit or table is shown by now.
      if (box.isConnected && state().table === now.table) set({ posterior: id });
    });
  };
  return el("form", { onsubmit: send },
    el("p", { class: "quiet" }, "Not sampled yet: which parameters the data hold, together."),
    el("div", { class: "controls" }, field("Budget / s", budget), field("Effective sample size", ess), el("div", { class: "field" }, el("button", { type: "submit", class: "main" }, "Sample the posterior"))), progress);
}

async function shown(id, fit, now) {
  const posterior = await get(`/v1/posteriors/${id}`, { panel: "fit" });
  const { request } = await get(posterior.links.job);
  recordStarted("fit", "/v1/posteriors", [{ fit: request.fit, ...request.spec }]);
  const channels = fit.model.channels;
  const channel = channels.includes(now.channel) ? now.channel : channels[0];
  const of = (label) => !label.includes("[") || label.endsWith(`[${channel}]`);
  const labels = posterior.labels.filter(of).slice(0, MOST);
  const columns = labels.map((label) => posterior.draws.map((row) => row[posterior.labels.indexOf(label)]));
  const { figure: made, box: plot } = figure(`Corner plot, ${posterior.draws.length} draws${channels.length > 1 ? `, channel ${channel}` : ""}`);
  plot.classList.add("square");
  setTimeout(() => drawCorner(plot, labels, columns, posterior));
  const rows = posterior.labels.filter(of).map((label) => {
    const { median, sd, lower, upper } = posterior.intervals[label], { rhat, ess_bulk } = posterior.diagnostics[label];
    return [label, number(median), number(sd, 2), `${number(lower)} to ${number(upper)}`, number(rhat, 4), number(Math.round(ess_bulk))];
  });
  return el("div", { class: "two" }, made, el("div", {},
    facts([["Status", posterior.status], ["", posterior.message]]),
    channels.length > 1 ? el("div", { class: "controls" }, field("Channel", select(channels, channel, (value) => set({ channel: value })))) : "",
    grid("95 % credible intervals", ["parameter", "median", "sd", "interval", "R-hat", "ESS"], rows)));
}

async function drawCorner(plot, labels, columns, posterior) {
  const n = labels.length;
  const traces = [];
  const layout = { margin: { l: 64, r: 8, t: 8, b: 56 }, annotations: [] };
  const gap = 0.015;
  const ends = columns.map((column) => range(column));
  for (let row = 0; row < n; row++) {
    for (let column = 0; column <= row; column++) {
      const name = row * n + column + 1;
      const [x, y] = [`x${name}`, `y${name}`];
      const diagonal = row === column;
      const common = { nticks: 3, showgrid: false, tickfont: { size: 9 }, automargin: false };
      layout[`xaxis${name}`] = { ...common, anchor: y, domain: [column / n, (column + 1) / n - gap], range: ends[column], showticklabels: row === n - 1, title: { text: row === n - 1 ? labels[column] : "", font: { size: 11 } }, tickangle: -45 };
      layout[`yaxis${name}`] = { ...common, anchor: x, domain: [1 - (row + 1) / n, 1 - row / n - gap], ...(diagonal ? {} : { range: ends[row] }), showticklabels: column === 0 && row > 0, title: { text: column === 0 && row > 0 ? labels[row] : "", font: { size: 11 } } };
      if (diagonal) {
        const counts = histogram(columns[row], ends[row]);
        traces.push({ type: "bar", x: counts.map((_, k) => middle(ends[row], k)), y: counts, marker: { color: COLOURS[0] }, xaxis: x, yaxis: y, hoverinfo: "skip" });
        const { lower, upper } = posterior.intervals[labels[row]];
        (layout.shapes ||= []).push(...[lower, upper].map((at) => ({ type: "line", xref: x, yref: `${y} domain`, x0: at, x1: at, y0: 0, y1: 1, line: { color: COLOURS[1], dash: "dash", width: 1 } })));
      } else {
        traces.push({ type: "heatmap", x: Array.from({ length: BINS }, (_, k) => middle(ends[column], k)), y: Array.from({ length: BINS }, (_, k) => middle(ends[row], k)), z: together(columns[column], columns[row], ends[column], ends[row]), colorscale: "Cividis", reversescale: true, showscale: false, xaxis: x, yaxis: y, hoverinfo: "skip" });
      }
    }
  }
  layout.bargap = 0;
  await draw(plot, traces, layout, `Corner plot of ${labels.join(", ")}: histograms with the ends of the 95 % interval, and how each pair goes together.`);
}

function range(column) {
  let low = Infinity, high = -Infinity;
  for (const v of column) if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); }
  return high > low ? [low, high] : [low - 1e-9, low + 1e-9];
}

const bin = ([low, high], v) => Math.min(BINS - 1, Math.floor(((v - low) / (high - low)) * BINS));
const middle = ([low, high], k) => low + ((k + 0.5) / BINS) * (high - low);

function histogram(column, ends) {
  const counts = new Array(BINS).fill(0);
  for (const v of column) if (v !== null) counts[bin(ends, v)]++;
  return counts;
}

function together(across, up, xEnds, yEnds) {
  const counts = Array.from({ length: BINS }, () => new Array(BINS).fill(0));
  across.forEach((v, k) => { if (v !== null && up[k] !== null) counts[bin(yEnds, up[k])][bin(xEnds, v)]++; });
  return counts.map((row) => row.map((n) => n || null));
}
