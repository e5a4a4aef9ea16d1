// The scattered lobe at one incidence as a surface whose radius is the scaled value.

import { COLOURS, SEQUENTIAL, bar, chosen, draw, inks, relayout, rgb, share } from "./plots.js";
import { button } from "./dom.js";
import { inWords, scale } from "./scales.js";

const CAMERA = { x: 0.1, y: -1.9, z: 1.05 };
const RAD = Math.PI / 180;

/** Draw a lobe document. */
export async function drawLobe(box, found, { choice, scaling, outside }) {
  const colour = choice === "all" ? rgb(found.channels) : null;
  const pick = chosen(found.channels, choice);
  const level = found.values.map((ring, m) => ring.map((row, k) => (found.extrapolated[m][k] && !outside ? null : pick(row))));
  const scaled = scale(scaling, level.flat().filter((v) => v !== null));
  const traces = [colour ? coloured(found, level, scaled, colour) : shaded(found, level, scaled)];
  traces.push(...surroundings(found.theta_i_deg));
  const flat = { visible: false, range: [-1.05, 1.05] };
  box.camera ||= { eye: { ...CAMERA }, center: { x: 0, y: 0, z: -0.36 } };
  const measured = level.flat().filter((v) => v !== null).length;
  const about = `Lobe of scattered light at an incidence of ${found.theta_i_deg}°: the radius is f_r, ${inWords(scaling)}, up to ${scaled.high.toPrecision(3)} per steradian; ${measured} of ${level.flat().length} directions are within what was measured.`;
  await draw(box, traces, {
    scene: { xaxis: flat, yaxis: flat, zaxis: { visible: false, range: [-0.02, 1.05] }, aspectmode: "manual", aspectratio: { x: 2, y: 2, z: 1 }, camera: box.camera, dragmode: "turntable" },
    margin: { l: 0, r: 0, t: 0, b: 0 },
  }, about);
  box.turned ??= box.on("plotly_relayout", (change) => {
    if (change["scene.camera"]) box.camera = change["scene.camera"];
  });
  return { scaled, empty: measured === 0 };
}

function place(found, m, k, radius) {
  const theta = found.theta_o_deg[m] * RAD;
  const turn = found.turn_deg[k] * RAD;
  // The light comes from -x, so that the specular side is to the right.
  return [-radius * Math.sin(theta) * Math.cos(turn), -radius * Math.sin(theta) * Math.sin(turn), radius * Math.cos(theta)];
}

function shaded(found, level, scaled) {
  const [x, y, z] = [0, 1, 2].map((axis) => level.map((ring, m) => ring.map((v, k) => (v === null ? null : place(found, m, k, share(scaled, v))[axis]))));
  const text = level.map((ring, m) => ring.map((v, k) => `θ_o = ${found.theta_o_deg[m]}°, ${found.turn_deg[k]}° from the light<br>${v === null ? "–" : v.toPrecision(4)} 1/sr`));
  return {
    type: "surface", x, y, z, surfacecolor: level.map((ring) => ring.map((v) => (v === null ? null : scaled.at(v) ?? scaled.from))), cmin: scaled.from, cmax: scaled.to,
    colorscale: SEQUENTIAL, colorbar: bar(scaled, "f_r / (1/sr)"), hovertext: text, hoverinfo: "text", connectgaps: false, lighting: { ambient: 0.75, diffuse: 0.5, specular: 0.05 },
  };
}

function coloured(found, level, scaled, channels) {
  const columns = found.turn_deg.length;
  const x = [], y = [], z = [], colours = [], i = [], j = [], k = [];
  level.forEach((ring, m) => ring.forEach((v, n) => {
    const [a, b, c] = place(found, m, n, share(scaled, v));
    x.push(a); y.push(b); z.push(c);
    colours.push(`rgb(${channels.map((at) => Math.round(255 * share(scaled, found.values[m][n][at])))})`);
    const corners = [[m, n], [m + 1, n], [m, n + 1], [m + 1, n + 1]];
    if (m + 1 < level.length && n + 1 < columns && corners.every(([a, b]) => level[a][b] !== null)) {
      const [p, q, r, s] = corners.map(([a, b]) => a * columns + b);
      i.push(p, q); j.push(q, s); k.push(r, r);
    }
  }));
  return { type: "mesh3d", x, y, z, i, j, k, vertexcolor: colours, hoverinfo: "skip", lighting: { ambient: 0.8, diffuse: 0.4, specular: 0.05 }, flatshading: false };
}

/** The surface, the light and the mirror direction. */
function surroundings(theta) {
  const { quiet } = inks();
  const s = Math.sin(theta * RAD), c = Math.cos(theta * RAD);
  const circle = Array.from({ length: 73 }, (_, n) => n * 5 * RAD);
  const common = { type: "scatter3d", mode: "lines", hoverinfo: "name" };
  return [
    { ...common, name: "surface", x: circle.map(Math.cos), y: circle.map(Math.sin), z: circle.map(() => 0), line: { color: quiet, width: 2 } },
    { ...common, name: "light", mode: "lines+text", x: [-s, 0], y: [0, 0], z: [c, 0], text: ["light", ""], textposition: "top center", line: { color: COLOURS[4], width: 6 } },
    { ...common, name: "mirror direction", mode: "lines+text", x: [0, s], y: [0, 0], z: [0, c], text: ["", "mirror"], textposition: "top center", line: { color: quiet, width: 4, dash: "dash" } },
  ];
}

/** Buttons that turn the lobe, for who has no mouse. */
export function turning(box) {
  const turn = (about, up) => {
    const { eye, center } = box.camera || {};
    if (!eye) return;
    const flat = Math.hypot(eye.x, eye.y);
    const azimuth = Math.atan2(eye.y, eye.x) + about * RAD;
    const height = Math.min(89, Math.max(-5, Math.atan2(eye.z, flat) / RAD + up)) * RAD;
    const far = Math.hypot(flat, eye.z);
    const moved = { x: far * Math.cos(height) * Math.cos(azimuth), y: far * Math.cos(height) * Math.sin(azimuth), z: far * Math.sin(height) };
    box.camera = { eye: moved, center };
    relayout(box, { "scene.camera": box.camera });
  };
  const row = document.createElement("p");
  row.className = "row small";
  row.append(
    button("◀", () => turn(-15, 0), { "aria-label": "turn left" }), button("▶", () => turn(15, 0), { "aria-label": "turn right" }),
    button("▲", () => turn(0, 15), { "aria-label": "tilt up" }), button("▼", () => turn(0, -15), { "aria-label": "tilt down" }),
  );
  return row;
}
