// What a fit's report shows: slices with their band, and maps of residuals. The report is made when first asked for.

import { el, fill, field, number, select } from "./dom.js";
import { get } from "./http.js";
import { DIVERGING, colourOf, draw, figure, inks, scaledAxis } from "./plots.js";
import { SCALES, scale } from "./scales.js";
import { set } from "./state.js";

const reports = new Map();
const WAITING = "The report is being made: residuals, bands and the uncertainty budget. The first one takes some seconds, up to a minute on a cold server …";
const NAMES = {
  theta_h: "half angle θ_h / °", theta_d: "difference angle θ_d / °", theta_i: "incidence θ_i / °", theta_o: "scattering θ_o / °",
  theta_o_signed: "θ_o / ° (positive: specular side)", phi: "azimuth from the mirror direction / °",
};
/** Residuals beyond this are drawn like it. */
const MOST = 0.5;

/** A fit's report with its latest posterior, kept while the page is open. */
export function reportOf(fit, posterior = "") {
  const name = fit.id + posterior;
  if (!reports.has(name)) {
    const made = get(`/v1/fits/${fit.id}/report.json`, { panel: "fit" });
    reports.set(name, made);
    made.catch(() => reports.delete(name));
  }
  return reports.get(name);
}

/** Data, fit and band at one incidence. */
export function bands(box, fit, now) {
  const here = JSON.stringify([fit.id, now.posterior, now.incidence, now.channel, now.scale]);
  if (box.here === here) return;
  box.here = here;
  fill(box, box.plot ? "" : WAITING, async () => {
    const { slices } = await reportOf(fit, now.posterior);
    if (!slices.slices.length) return el("p", {}, "No sample lies near the plane of incidence.");
    const middle = Math.floor(slices.slices.length / 2);
    const k = Math.min(now.incidence === "" ? middle : Number(now.incidence) || 0, slices.slices.length - 1);
    const channel = slices.channels.includes(now.channel) ? now.channel : slices.channels[0];
    const controls = el("div", { class: "controls" },
      field("Incidence", select(slices.slices.map((one, n) => [String(n), `θ_i = ${number(one.theta_i_deg)}°`]), String(k), (value) => set({ incidence: value }))),
      field("Channel", select(slices.channels, channel, (value) => set({ channel: value }))), field("Scale of f_r", select(SCALES, now.scale, (value) => set({ scale: value }))));
    const { figure: made, box: plot } = figure(`θ_i = ${number(slices.slices[k].theta_i_deg)}°, ${channel}, samples within ${slices.plane_tolerance_deg}° of the plane`);
    box.plot = plot;
    setTimeout(() => drawBand(plot, slices.slices[k], channel, now.scale, fit.model.name));
    const words = [slices.predictive_level && "Light band: where 95 % of new measurements are expected, judged by leaving scans out", slices.level && "dark band: 95 % credible, of the posterior"].filter(Boolean);
    return [controls, made, el("p", { class: "quiet" }, `${words.join("; ")}. Dashed: the mirror direction.`)];
  });
}

async function drawBand(plot, slice, channel, scaling, model) {
  const { curve, points } = slice;
  const colour = colourOf(channel, 0);
  const edges = [["predictive_lower", "predictive_upper", 0.18], ["lower", "upper", 0.45]].filter(([low]) => curve[low]);
  const all = [...points.measured[channel], ...curve.fit[channel], ...edges.flatMap(([low, high]) => [...curve[low][channel], ...curve[high][channel]])];
  // A band may reach to zero: the measured values say how far down a logarithmic axis goes.
  const scaled = scale(scaling, scaling === "log" ? [...points.measured[channel], ...curve.fit[channel]].flatMap((v) => (v > 0 ? [v / 2, v * 2] : [])) : all);
  const onAxis = (v) => scaled.at(v) ?? scaled.from;
  const traces = edges.map(([low, high, opacity]) => ({
    type: "scatter", mode: "lines", fill: "toself", line: { width: 0 }, fillcolor: colour, opacity, hoverinfo: "skip", name: low === "lower" ? "95 % credible" : "95 % of new measurements",
    x: [...curve.theta_o_deg, ...[...curve.theta_o_deg].reverse()], y: [...curve[low][channel].map(onAxis), ...[...curve[high][channel]].reverse().map(onAxis)],
  }));
  traces.push({ type: "scatter", mode: "lines", x: curve.theta_o_deg, y: curve.fit[channel].map(scaled.at), name: model, line: { color: colour, width: 2 } });
  traces.push({
    type: "scatter", mode: "markers", x: points.theta_o_deg, y: points.measured[channel].map(scaled.at), name: "measured", marker: { color: "rgba(0,0,0,0)", size: 6, line: { color: "#777777", width: 1.4 } },
    hovertext: points.theta_o_deg.map((x, n) => `θ_o = ${x}°: ${number(points.measured[channel][n])} 1/sr`), hoverinfo: "text",
  });
  const mirror = { type: "line", yref: "paper", y0: 0, y1: 1, x0: slice.theta_i_deg, x1: slice.theta_i_deg, layer: "between", line: { color: "#888888", dash: "dash", width: 1 } };
  await draw(plot, traces, { xaxis: { title: { text: NAMES.theta_o_signed } }, yaxis: scaledAxis(scaled, "f_r / (1/sr)"), showlegend: true, shapes: [mirror] },
    `Measured in-plane samples at θ_i = ${slice.theta_i_deg}°, the fitted ${model} and its 95 % band, channel ${channel}.`);
}

/** A map for each fit, of the same angles, with one scale of colours. */
export function residualMaps(box, fits, now) {
  const here = JSON.stringify([fits.map((fit) => fit.id), now.channel, now.residuals]);
  if (box.here === here) return;
  box.here = here;
  fill(box, box.firstChild ? "" : WAITING, async () => {
    const found = [];
    for (const fit of fits) found.push([fit, (await reportOf(fit)).residuals]);
    const [, first] = found[0];
    const pairs = [first.map, ...first.further_maps].map((one) => [`${one.x}/${one.y}`, `${NAMES[one.x]} and ${NAMES[one.y]}`]);
    const wanted = pairs.find(([name]) => name === now.residuals)?.[0] || pairs[0][0];
    const channel = first.shown.includes(now.channel) ? now.channel : first.shown[0];
    const drawn = found.map(([fit, residuals], k) => {
      const map = [residuals.map, ...residuals.further_maps].find((one) => `${one.x}/${one.y}` === wanted) || residuals.map;
      const stated = residuals.per_channel.find((one) => one.channel === channel);
      const { figure: made, box: plot } = figure(`${fit.model.name}: bias ${number(100 * stated.relative_bias, 2)} %, rms ${number(100 * stated.relative_rmse, 3)} %`);
      plot.classList.add("low");
      setTimeout(() => drawMap(plot, map, channel, fit.model.name, k));
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

