// What was understood of a file: facts, the picture that proves it, the check, and the correction.

import { card, degrees, el, facts, field, fill, grid, number, problem, say, select } from "./dom.js";
import { forget, get, post } from "./http.js";
import { COLOURS, MARKS, draw, figure, inks, scaledAxis } from "./plots.js";
import { OPTIONS, inWords } from "./reading.js";
import { scale } from "./scales.js";
import { ofTable, set } from "./state.js";
import { again } from "./tables.js";

const SIGNS = { ok: "✓", notice: "●", warning: "▲" };

/** Everything that is known of a table; `before` is the reading that it corrects. */
export async function understood(id, before) {
  forget("table");
  const table = await get(`/v1/tables/${id}`, { panel: "table" });
  const old = before ? await get(`/v1/tables/${before}`) : null;
  const checks = el("div", {});
  const { figure: made, box } = figure("In-plane samples, as measured", el("p", { class: "quiet" }, old
    ? "Filled marks: this reading; hollow ones: the one before. Solid and dashed lines: light and mirror direction."
    : "A peak belongs at the dashed line of its colour, the mirror direction; at the solid one it would be on the light's side."));
  fill(box, "Looking at every sample …", () => pictured(box, id, before));
  fill(checks, "Checking: noise, reciprocity, energy, conventions …", () => checked(id));
  return [
    el("h2", {}, table.name),
    el("div", { class: "two" },
      el("div", {}, card("What was understood", understanding(table)), card("Correct the reading", correcting(table))),
      el("div", {}, card("The picture that proves it", made, peaks(table, old)), card("Quality check", checks))),
  ];
}

function understanding({ description: d, options, bytes }) {
  const lines = d.channels.map((c) => `${c.name}${c.wavelength_nm ? ` (${number(c.wavelength_nm)} nm)` : ""}: ${number(c.min_per_sr, 3)} to ${number(c.max_per_sr, 3)} 1/sr`);
  const masked = Object.entries(d.masked).map(([why, count]) => `${number(count)} ${why}`);
  const given = Object.entries(options).map(([name, value]) => `${name} = ${typeof value === "object" ? JSON.stringify(value) : value}`);
  return [
    facts([
      ["Format", `${d.format}, ${number(bytes)} bytes`],
      ["The file held", inWords("quantity", d.quantity)],
      ["Convention", d.convention && inWords("convention", d.convention)],
      ["Symmetry", d.symmetry],
      ["Samples", `${number(d.samples)}, ${number(d.usable)} usable`],
      ["Masked", masked.join("; ")],
      ["Grid", d.grid ? `${d.grid.system || "grid"}${d.grid.shape ? ` ${d.grid.shape.join(" × ")}` : ""}` : "scattered samples"],
      ["Domain", `θ_i ${d.domain.theta_i_deg.map(degrees).join(" to ")}, θ_o ${d.domain.theta_o_deg.map(degrees).join(" to ")}${d.domain.in_plane ? ", in the plane of incidence only" : ""}`],
      ["Incidences", number(d.domain.incidences)],
      ["Stated noise", d.sigma ? "one standard uncertainty a value" : "none"],
      ["Told by you", given.join(", ")],
    ]),
    el("h4", {}, "Channels"), el("ul", {}, lines.slice(0, 8).map((text) => el("li", {}, text)), lines.length > 8 && el("li", {}, `and ${lines.length - 8} more`)),
    d.notes.length ? [el("h4", {}, "Notes"), el("ul", {}, d.notes.map((note) => el("li", {}, note)))] : null,
  ].flat();
}

/** Where the strongest sample is, at each incidence, and where it was before. */
function peaks({ description }, old) {
  if (!description.peaks.length) return null;
  const of = (side) => (side ? `${degrees(side.theta_o_deg)}: ${number(side.value_per_sr, 3)}` : "–");
  const strongest = (peak) => ((peak.specular_side?.value_per_sr ?? -1) >= (peak.retro_side?.value_per_sr ?? -1) ? "specular" : "light's");
  const rows = description.peaks.map((peak) => {
    const then = old?.description.peaks.find((one) => Math.abs(one.theta_i_deg - peak.theta_i_deg) < 0.5);
    const moved = then && strongest(then) !== strongest(peak) ? ` (was ${strongest(then)})` : "";
    return [degrees(peak.theta_i_deg), of(peak.specular_side), of(peak.retro_side), `${strongest(peak)} side${moved}`];
  });
  return grid("Peaks, θ_o: mean f_r / (1/sr)", ["θ_i", "specular side", "light's side", "the stronger"], rows);
}

async function pictured(box, id, before) {
  const [now, then] = await Promise.all([id, before].map((one) => (one ? get(`/v1/tables/${one}/cuts`, { panel: one === id ? "table" : null }) : null)));
  if (!now.cuts.length) return el("p", {}, "No usable sample lies near the plane of incidence.");
  const mean = (row) => row.reduce((a, b) => a + b, 0) / row.length;
  const level = (cut) => cut.values.map(mean);
  const scaled = scale("log", [...now.cuts, ...(then?.cuts || [])].flatMap(level));
  const traces = [];
  const shapes = [];
  now.cuts.forEach((cut, k) => {
    const colour = COLOURS[k % COLOURS.length];
    const name = `θ_i = ${degrees(cut.theta_i_deg)}`;
    const earlier = then?.cuts.find((one) => Math.abs(one.theta_i_deg - cut.theta_i_deg) < 0.5);
    if (earlier) traces.push({ type: "scatter", mode: "markers", x: earlier.theta_o_deg, y: level(earlier).map(scaled.at), name: `${name} before`, showlegend: false, marker: { symbol: `${MARKS[k]}-open`, color: colour, size: 6 }, opacity: 0.6 });
    traces.push({
      type: "scatter", mode: "lines+markers", x: cut.theta_o_deg, y: level(cut).map(scaled.at), name, line: { color: colour, width: 1.4 }, marker: { symbol: MARKS[k], size: 5 },
      hovertext: cut.theta_o_deg.map((x, n) => `${name}<br>θ_o = ${degrees(x)}<br>${number(level(cut)[n])} 1/sr`), hoverinfo: "text",
    });
    for (const [x, dash] of [[cut.theta_i_deg, "dash"], [-cut.theta_i_deg, "solid"]]) shapes.push({ type: "line", yref: "paper", y0: 0, y1: 1, x0: x, x1: x, layer: "between", line: { color: colour, width: 1, dash } });
  });
  box.replaceChildren();
  const { quiet } = inks();
  await draw(box, traces, {
    xaxis: { title: { text: "θ_o / ° (positive: specular side)" }, range: [-92, 92], tickvals: [-90, -60, -30, 0, 30, 60, 90] }, yaxis: scaledAxis(scaled, "mean f_r / (1/sr)"), showlegend: true, shapes,
    annotations: [["light's side", 0.01, "left"], ["specular side", 0.99, "right"]].map(([text, x, xanchor]) => ({ text, x, xanchor, y: 1, yanchor: "top", xref: "paper", yref: "paper", showarrow: false, font: { color: quiet } })),
  }, `In-plane samples at ${now.cuts.length} incidences within ${now.plane_deg}° of the plane of incidence, mean of ${now.channels.length} channels.`);
}

async function checked(id) {
  const found = await get(`/v1/tables/${id}/check`, { panel: "table" });
  const order = { warning: 0, notice: 1, ok: 2 };
  const sorted = [...found.findings].sort((a, b) => order[a.verdict] - order[b.verdict]);
  return [
    el("p", {}, `${SIGNS[found.verdict]} ${found.verdict}: ${found.findings.length} findings, ${number(found.looked_at)} of ${number(found.samples)} samples looked at.`),
    el("ul", { class: "findings" }, sorted.map((one) => el("li", { class: one.verdict }, el("strong", {}, `${SIGNS[one.verdict]} ${one.name.replaceAll("_", " ")} (${one.judged ? one.verdict : "not judged"})`), " ", one.sentence))),
  ];
}

function correcting(table) {
  const controls = Object.fromEntries(Object.entries(OPTIONS).map(([name, { values }]) => [name, select([["", "as it is"], ...values], "")]));
  const outcome = el("div", {});
  const send = async (event) => {
    event.preventDefault();
    const given = Object.entries(controls).filter(([, control]) => control.value).map(([name, control]) => [name, control.value]);
    if (!given.length) {
      outcome.replaceChildren(el("p", { class: "quiet" }, "Choose what to read otherwise."));
      return;
    }
    outcome.replaceChildren(el("p", { class: "quiet waiting" }, "Reading again …"));
    try {
      const made = await post(`/v1/tables/${table.id}/readings?${new URLSearchParams(given)}`, undefined, { panel: "table" });
      say("read again: the picture shows both readings");
      again();
      set(ofTable(made.id, table.id), true);
    } catch (error) {
      outcome.replaceChildren(problem(error));
    }
  };
  return el("form", { class: "stack", onsubmit: send },
    el("p", { class: "quiet" }, "The same bytes are read again, as another measurement; nothing is uploaded, and this reading stays."),
    Object.entries(OPTIONS).map(([name, option]) => field(option.label, controls[name])),
    el("p", {}, el("button", { type: "submit", class: "main" }, "Read it again")), outcome);
}
