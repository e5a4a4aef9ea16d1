// Images: the whole table over half and difference angle, and which polar angles were measured.

import { SEQUENTIAL, bar, chosen, draw, inks, rgb, share } from "./plots.js";
import { scale } from "./scales.js";

/** Half angles that have a tick; the axis is even in their square roots, as the lobe is narrow. */
const HALF = [0, 1, 5, 10, 20, 40, 60, 90];

export async function drawHalfDifference(box, found, { choice, scaling }) {
  const colour = choice === "all" ? rgb(found.channels) : null;
  const pick = chosen(found.channels, choice);
  const level = found.values.map((row) => row.map((values) => (values[0] === null ? null : pick(values))));
  const scaled = scale(scaling, level.flat().filter((v) => v !== null));
  const x = found.theta_h_deg.map(Math.sqrt);
  const axes = {
    xaxis: { title: { text: "half angle θ_h / ° (even in its root)" }, range: [0, Math.sqrt(90)], tickvals: HALF.map(Math.sqrt), ticktext: HALF.map(String), showgrid: false },
    yaxis: { title: { text: "difference angle θ_d / °" }, range: [0, 90], tickvals: [0, 15, 30, 45, 60, 75, 90], showgrid: false, scaleanchor: false },
    plot_bgcolor: inks().blank,
  };
  const text = level.map((row, d) => row.map((v, h) => `θ_h = ${found.theta_h_deg[h].toFixed(2)}°, θ_d = ${found.theta_d_deg[d].toFixed(1)}°<br>${v === null ? "not measured" : `${v.toPrecision(4)} 1/sr, ${found.samples[d][h]} samples`}`));
  const about = `Mean f_r over half and difference angle, ${found.looked_at} samples, from ${scaled.low.toPrecision(3)} to ${scaled.high.toPrecision(3)} per steradian.`;
  const trace = colour
    ? { type: "image", ...raster(found, level, scaled, colour, x), hoverinfo: "skip" }
    : { type: "heatmap", x, y: found.theta_d_deg, z: level.map((row) => row.map((v) => (v === null ? null : scaled.at(v) ?? scaled.from))), zmin: scaled.from, zmax: scaled.to, colorscale: SEQUENTIAL, colorbar: bar(scaled, "f_r / (1/sr)"), hovertext: text, hoverinfo: "text", hoverongaps: false };
  await draw(box, [trace], axes, about);
}

/** Even pixels in sqrt(theta_h) and theta_d, each of the nearest cell. */
function raster(found, level, scaled, channels, x, side = 120) {
  const nearest = (nodes, at) => nodes.reduce((best, node, k) => (Math.abs(node - at) < Math.abs(nodes[best] - at) ? k : best), 0);
  const dx = Math.sqrt(90) / side, dy = 90 / side;
  const columns = Array.from({ length: side }, (_, n) => nearest(x, (n + 0.5) * dx));
  const rows = Array.from({ length: side }, (_, n) => nearest(found.theta_d_deg, (n + 0.5) * dy));
  const z = rows.map((d) => columns.map((h) => (level[d][h] === null ? [0, 0, 0, 0] : [...channels.map((k) => 255 * share(scaled, found.values[d][h][k])), 1])));
  return { z, x0: dx / 2, dx, y0: dy / 2, dy, colormodel: "rgba" };
}

export async function drawCoverage(box, found) {
  const flat = found.usable.flat();
  const most = Math.max(1, ...flat);
  const log = most > 50;
  const shown = found.usable.map((row) => row.map((n) => (n > 0 ? (log ? Math.log10(n) : n) : null)));
  const onlyMasked = found.masked.map((row, i) => row.map((n, o) => (n > 0 && found.usable[i][o] === 0 ? 1 : null)));
  const text = found.usable.map((row, i) => row.map((n, o) => `θ_i ${span(found.theta_i_deg, i)}, θ_o ${span(found.theta_o_deg, o)}<br>${n} usable, ${found.masked[i][o]} masked`));
  const scaled = scale(log ? "log" : "linear", flat.filter((n) => n > 0));
  const common = { type: "heatmap", x: found.theta_o_deg, y: found.theta_i_deg, hovertext: text, hoverinfo: "text", hoverongaps: false };
  const traces = [{ ...common, z: shown, colorscale: "Cividis", zmin: 0, zmax: log ? Math.log10(most) : most, colorbar: bar(scaled, "usable samples") }];
  const masked = onlyMasked.flat().filter(Boolean).length;
  if (masked) traces.push({ ...common, z: onlyMasked, colorscale: [[0, "#d55e00"], [1, "#d55e00"]], showscale: false });
  await draw(box, traces, {
    xaxis: { title: { text: "scattering θ_o / °" }, range: [0, 90], tickvals: [0, 15, 30, 45, 60, 75, 90], showgrid: false },
    yaxis: { title: { text: "incidence θ_i / °" }, range: [0, 90], tickvals: [0, 15, 30, 45, 60, 75, 90], showgrid: false },
    plot_bgcolor: inks().blank,
  }, `Usable samples by incidence and scattering angle, ${found.looked_at} counted; ${masked} cells hold masked samples only.`);
  return masked;
}

const span = (edges, k) => `${edges[k].toFixed(1)}° to ${edges[k + 1].toFixed(1)}°`;
