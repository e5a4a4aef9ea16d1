// In-plane slices: polar and Cartesian, of a table and of models of it.

import { COLOURS, DASHES, colourOf, draw, scaledAxis, inks } from "./plots.js";
import { scale } from "./scales.js";

export const ANGLE = "θ_o / ° (positive: specular side)";
export const VALUE = "f_r / (1/sr)";

/** Curves [{name, x, y, outside?, colour, dash, mode}] at one incidence; `marks` are incidences to mark. */
export async function drawSlices(box, curves, { polar, scaling, thetas, about }) {
  const scaled = scale(scaling, curves.flatMap((curve) => curve.y));
  const traces = curves.flatMap((curve) => traced(curve, scaled, polar));
  const { grid, quiet } = inks();
  if (polar) {
    for (const theta of thetas) {
      traces.push(ray(theta, scaled, { color: quiet, dash: "dash", width: 1 }, "mirror direction"));
      traces.push(ray(-theta, scaled, { color: COLOURS[4], width: 2 }, "light"));
    }
    await draw(box, traces, {
      polar: {
        sector: [0, 180], angularaxis: {
          rotation: 90, direction: "clockwise", tickvals: [-90, -60, -30, 0, 30, 60, 90], ticktext: ["−90°", "−60°", "−30°", "0°", "30°", "60°", "90°"],
          gridcolor: grid, linecolor: grid,
        },
        radialaxis: { range: [scaled.from, scaled.to + 0.03 * (scaled.to - scaled.from)], tickvals: scaled.tickvals, ticktext: scaled.ticktext, gridcolor: grid, linecolor: quiet, angle: 90, tickangle: 90, tickfont: { size: 10 } },
      },
      showlegend: curves.length > 1, margin: { l: 36, r: 36, t: 20, b: 8 }, legend: { orientation: "h", y: 0.02, x: 0.5, xanchor: "center", yanchor: "top", font: { size: 11 } },
    }, about);
  } else {
    await draw(box, traces, {
      xaxis: { title: { text: ANGLE }, range: [-92, 92], tickvals: [-90, -60, -30, 0, 30, 60, 90] }, yaxis: scaledAxis(scaled, VALUE), showlegend: curves.length > 1,
      shapes: thetas.flatMap((theta) => [line(theta, quiet, "dash"), line(-theta, COLOURS[4], "solid")]),
    }, about);
  }
}

const line = (x, color, dash) => ({ type: "line", xref: "x", yref: "paper", x0: x, x1: x, y0: 0, y1: 1, line: { color, dash, width: 1.2 }, layer: "between" });

const ray = (theta, scaled, line, name) => ({
  type: "scatterpolar", mode: "lines", theta: [theta, theta], r: [scaled.from, scaled.to], line, name, showlegend: false, hoverinfo: "name",
});

/** A curve, dotted and thin where nothing was measured. */
function traced(curve, scaled, polar) {
  const placed = curve.y.map(scaled.at);
  const text = curve.x.map((x, k) => `${curve.name}<br>θ_o = ${x.toFixed(2)}°<br>${curve.y[k] === null ? "–" : curve.y[k].toPrecision(4)} 1/sr`);
  const base = { name: curve.name, hovertext: text, hoverinfo: "text", connectgaps: false, legendgroup: curve.name, mode: curve.mode || "lines" };
  const marker = { color: curve.colour, size: 5, symbol: curve.symbol || "circle" };
  const axes = (y) => (polar ? { type: "scatterpolar", theta: curve.x, r: y } : { type: "scatter", x: curve.x, y });
  const drawn = { color: curve.colour, dash: curve.dash || "solid", width: 1.8 };
  if (!curve.outside?.some(Boolean)) return [{ ...base, ...axes(placed), line: drawn, marker }];
  const inside = placed.map((v, k) => (curve.outside[k] ? null : v));
  const beyond = placed.map((v, k) => (curve.outside[k] || curve.outside[k - 1] || curve.outside[k + 1] ? v : null));
  return [
    { ...base, ...axes(inside), line: drawn, marker },
    { ...base, ...axes(beyond), line: { ...drawn, dash: "dot", width: 1 }, opacity: 0.6, showlegend: false },
  ];
}

/** Curves of columns of values (n, C): each channel, one of them, or what `pick` makes of a row. */
export function byChannel(name, channels, choice, x, values, more = {}) {
  const shown = channels.map((_, k) => k).filter((k) => choice === "all" || channels[k] === choice);
  return shown.slice(0, 7).map((k, n) => ({
    name: name ? `${name} ${channels[k]}` : channels[k], x, y: values.map((row) => row[k]), colour: colourOf(channels[k], k), dash: DASHES[n % 3], ...more,
  }));
}
