// Fits beside their data: slices with a band, and maps of residuals.

import { el, fill, field, number, percent, problem, select } from "./dom.js";
import { get } from "./http.js";
import { COLOURS, DASHES, DIVERGING, draw, figure, inks, scaledAxis } from "./plots.js";
import { SCALES, scale } from "./scales.js";
import { set } from "./state.js";

const kept = new Map();
const NAMES = {
  theta_h: "half angle θ_h / °", theta_d: "difference angle θ_d / °", theta_i: "incidence θ_i / °", theta_o: "scattering θ_o / °",
  theta_o_signed: "θ_o / ° (positive: specular side)", phi: "azimuth from the mirror direction / °",
};
/** Residuals beyond this are drawn like it. */
const MOST = 0.5;
/** Answers that are kept at the most: a report may be of some megabytes. */
const KEPT = 24;

/** Something of a fit, of the last asked for; `as` tells what may differ apart. */
function once(fit, what, as = "") {
  const name = [fit.id, what, as].join();
  if (!kept.has(name)) {
    const asked = get(`/v1/fits/${fit.id}/${what}`, { panel: "fit" });
    kept.set(name, asked);
    if (kept.size > KEPT) kept.delete(kept.keys().next().value);
    asked.catch(() => kept.delete(name));
  }
  return kept.get(name);
}

/** Data and fits at one incidence, and the band of the one in focus as soon as its report is made. */
export function bands(box, fits, fit, now) {
  const here = JSON.stringify([fit.id, now.posterior, now.incidence, now.channel, now.scale]);
  if (box.here === here) return;
  box.here = here;
  fill(box, box.firstChild ? "" : "Evaluating the fits …", async () => {
    const sections = await Promise.all(fits.map((one) => once(one, "slices")));
    const own = sections[fits.indexOf(fit)];
    if (!own.slices.length) return el("p", {}, "No sample lies near the plane of incidence.");
    const middle = Math.floor(own.slices.length / 2);
    const k = Math.min(now.incidence === "" ? middle : Number(now.incidence) || 0, own.slices.length - 1);
    const channel = own.channels.includes(now.channel) ? now.channel : own.channels[0];
    const controls = el("div", { class: "controls" },
      field("Incidence", select(own.slices.map((one, n) => [String(n), `θ_i = ${number(one.theta_i_deg)}°`]), String(k), (value) => set({ incidence: value }))),
      field("Channel", select(own.channels, channel, (value) => set({ channel: value }))), field("Scale of f_r", select(SCALES, now.scale, (value) => set({ scale: value }))));
    const { figure: made, box: plot } = figure(`θ_i = ${number(own.slices[k].theta_i_deg)}°, ${channel}, samples within ${own.plane_tolerance_deg}° of the plane`);
    const said = el("p", { class: "quiet", role: "status" }, "Dashed line: the mirror direction. The band is being computed, with the report …");
    const curves = fits.map((one, n) => ({ name: one.model.name, focus: one === fit, k: n, curve: sections[n].slices[k]?.curve })).filter(({ curve }) => curve?.fit[channel]);
    const view = { slice: own.slices[k], curves, channel, scaling: now.scale };
    setTimeout(() => drawBand(plot, view));
    once(fit, "report.json", now.posterior).then(({ slices }) => {
      if (!plot.isConnected) return;
      drawBand(plot, { ...view, band: slices.slices[k]?.curve });
      const words = [slices.predictive_level && "Light band: where 95 % of new measurements are expected, judged by leaving scans out", slices.level && "dark band: 95 % credible, of the posterior"].filter(Boolean);
      said.textContent = `${words.join("; ")}. Dashed line: the mirror direction.`;
    }, (error) => said.replaceWith(problem(error)));
    return [controls, made, said];
  });
}

async function drawBand(plot, { slice, curves, channel, scaling, band }) {
  const measured = slice.points.measured[channel];
  const focus = curves.find((one) => one.focus);
  const colour = COLOURS[focus.k % COLOURS.length];
  const edges = [["predictive_lower", "predictive_upper", 0.18], ["lower", "upper", 0.45]].filter(([low]) => band?.[low]);
  const lines = curves.flatMap(({ curve }) => curve.fit[channel]);
  const ends = edges.flatMap((pair) => pair.flatMap((name) => band[name]?.[channel] || []));
  // A band may reach to zero: the measured values say how far down a logarithmic axis goes.
  const scaled = scale(scaling, scaling === "log" ? measured.flatMap((v) => (v > 0 ? [v / 3, v * 3] : [])) : [...measured, ...lines, ...ends]);
  const onAxis = (v) => scaled.at(v) ?? scaled.from;
  const traces = edges.map(([low, high, opacity]) => ({
    type: "scatter", mode: "lines", fill: "toself", line: { width: 0 }, fillcolor: colour, opacity, hoverinfo: "skip", name: low === "lower" ? "95 % credible" : "95 % of new measurements",
    x: [...band.theta_o_deg, ...[...band.theta_o_deg].reverse()], y: [...band[low][channel].map(onAxis), ...[...band[high][channel]].reverse().map(onAxis)],
  }));
  for (const { name, k, curve, focus: here } of curves) {
    traces.push({ type: "scatter", mode: "lines", x: curve.theta_o_deg, y: curve.fit[channel].map(scaled.at), name, line: { color: COLOURS[k % COLOURS.length], width: here ? 2.4 : 1.3, dash: here ? "solid" : DASHES[1 + (k % 3)] }, hoverinfo: "name" });
  }
  const { theta_o_deg } = slice.points;
  traces.push({
    type: "scatter", mode: "markers", x: theta_o_deg, y: measured.map(scaled.at), name: "measured", marker: { color: "rgba(0,0,0,0)", size: 6, line: { color: "#808080", width: 1.4 } },
    hovertext: theta_o_deg.map((x, n) => `θ_o = ${x}°: ${number(measured[n])} 1/sr`), hoverinfo: "text",
  });
  const mirror = { type: "line", yref: "paper", y0: 0, y1: 1, x0: slice.theta_i_deg, x1: slice.theta_i_deg, layer: "between", line: { color: "#888888", dash: "dash", width: 1 } };
  await draw(plot, traces, { xaxis: { title: { text: NAMES.theta_o_signed } }, yaxis: scaledAxis(scaled, "f_r / (1/sr)"), showlegend: true, shapes: [mirror] },
    `Measured in-plane samples at θ_i = ${number(slice.theta_i_deg)}°, channel ${channel}, with ${curves.map((one) => one.name).join(", ")}${band ? ` and the 95 % band of ${focus.name}` : ""}.`);
}

/** A map for each fit, of the same angles, with one scale of colours. */
export function residualMaps(box, fits, now) {
  const here = JSON.stringify([fits.map((fit) => fit.id), now.channel, now.residuals]);
  if (box.here === here) return;
  box.here = here;
  fill(box, box.firstChild ? "" : "Evaluating the fits …", async () => {
    const found = await Promise.all(fits.map(async (fit) => [fit, await once(fit, "residuals")]));
    const [, first] = found[0];
    const pairs = [first.map, ...first.further_maps].map((one) => [`${one.x}/${one.y}`, `${NAMES[one.x]} and ${NAMES[one.y]}`]);
    const wanted = pairs.find(([name]) => name === now.residuals)?.[0] || pairs[0][0];
    const channel = first.shown.includes(now.channel) ? now.channel : first.shown[0];
    const drawn = found.map(([fit, residuals]) => {
      const map = [residuals.map, ...residuals.further_maps].find((one) => `${one.x}/${one.y}` === wanted) || residuals.map;
      const stated = residuals.per_channel.find((one) => one.channel === channel);
      const { figure: made, box: plot } = figure(`${fit.model.name}: bias ${percent(stated.relative_bias, 2)}, rms ${percent(stated.relative_rmse)}`);
      plot.classList.add("low");
      setTimeout(() => drawMap(plot, map, channel, fit.model.name));
      return made;
    });
    return [
      el("div", { class: "controls" }, field("Over", select(pairs, wanted, (value) => set({ residuals: value }))), field("Channel", select(first.shown, channel, (value) => set({ channel: value })))),
      el("div", { class: "many" }, drawn), el("p", { class: "quiet" }, `Medians of ${first.definition}. Orange: measured more than fitted; blue: less; beyond ± ${100 * MOST} % drawn like it. Grey: no sample.`),
    ];
  });
}

async function drawMap(plot, map, channel, model) {
  const root = map.x === "theta_h" ? Math.sqrt : (v) => v;
  const back = map.x === "theta_h" ? [0, 1, 5, 10, 20, 40, 60, 90] : null;
  await draw(plot, [{
    type: "heatmap", x: map.x_edges.map((v) => root(Math.max(v, map.x === "theta_h" ? 0 : v))), y: map.y_edges, z: map.median[channel], zmin: -MOST, zmax: MOST, colorscale: DIVERGING, hoverongaps: false,
    colorbar: { thickness: 10, tickvals: [-0.5, -0.25, 0, 0.25, 0.5], ticktext: ["−50 %", "−25 %", "0", "25 %", "50 %"], outlinewidth: 0 },
    hovertemplate: "%{z:.1%}<extra></extra>",
  }], {
    xaxis: { title: { text: NAMES[map.x] }, showgrid: false, ...(back && { tickvals: back.map(Math.sqrt), ticktext: back.map(String) }) }, yaxis: { title: { text: NAMES[map.y] }, showgrid: false },
    margin: { l: 50, r: 8, t: 4, b: 44 }, plot_bgcolor: inks().blank,
  }, `Median relative residuals of ${model}, channel ${channel}, over ${NAMES[map.x]} and ${NAMES[map.y]}.`);
}

