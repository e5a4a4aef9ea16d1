// The panel "Look": one incidence as a lobe and as slices, the whole table as an image, what was covered.

import { card, degrees, el, field, fill, number, select } from "./dom.js";
import { forget, get, post } from "./http.js";
import { drawLobe, turning } from "./lobe.js";
import { drawCoverage, drawHalfDifference } from "./maps.js";
import { COLOURS, figure } from "./plots.js";
import { SCALES, inWords } from "./scales.js";
import { byChannel, drawSlices } from "./slices.js";
import { set, state } from "./state.js";
import { fitsOf } from "./fits.js";

/** Milliseconds between a slider's last move and the request. */
const PATIENCE = 60;

let shown = null;
let parts = null;
let stopping = null;
let waiting = 0;

export function show(root, now) {
  if (!parts?.root.isConnected || shown.table !== now.table) {
    forget("look");
    shown = { table: now.table };
    parts = build(root, now);
    prepare(now);
    return;
  }
  update(now);
}

function build(root, now) {
  const theta = el("input", { type: "range", min: "0", max: "89.5", step: "0.5", value: now.theta_i, oninput: () => set({ theta_i: theta.value }) });
  const theta_exact = el("input", { type: "number", min: "0", max: "89.9", step: "any", value: now.theta_i, onchange: () => theta_exact.validity.valid && set({ theta_i: theta_exact.value || "0" }) });
  const phi = el("input", { type: "number", min: "-360", max: "360", step: "any", value: now.phi_i, onchange: () => phi.validity.valid && set({ phi_i: phi.value || "0" }) });
  const channel = select([["all", "all"]], "all", (value) => set({ channel: value }));
  const scaling = select(SCALES, now.scale, (value) => set({ scale: value }));
  const slices = select([["polar", "polar"], ["cartesian", "Cartesian"]], now.slices, (value) => set({ slices: value }));
  const overlay = select([["", "nothing"]], "", (value) => set({ overlay: value }));
  const outside = el("input", { type: "checkbox", checked: now.outside === "1", onchange: () => set({ outside: outside.checked ? "1" : "" }) });
  const phiField = field("Azimuth φ_i / °", phi);
  const measured = el("p", { class: "row small", "aria-label": "measured incidences", role: "group" });
  const controls = el("form", { class: "controls", onsubmit: (event) => event.preventDefault() },
    field("Incidence θ_i", theta), field("θ_i / °", theta_exact), phiField, field("Channel", channel), field("Scale of f_r", scaling), field("Slices", slices), field("Beside it", overlay),
    el("div", { class: "field check" }, el("label", {}, outside, " also what was not measured")));
  const lobe = figure("Radius and colour: f_r / (1/sr)"), slice = figure("f_r in the plane of incidence"), image = figure("Whole table: mean over φ_d"), covered = figure("Angles covered");
  const notes = { lobe: el("p", { class: "quiet" }), slice: el("p", { class: "quiet" }), covered: el("p", { class: "quiet" }) };
  root.replaceChildren(el("h2", {}, "Look at the data"), controls, measured, el("div", { class: "two" },
    card("3-D lobe", lobe.figure, turning(lobe.box), notes.lobe), card("In-plane slice", slice.figure, notes.slice),
    card("Half and difference angle", image.figure, el("p", { class: "quiet" }, "Grey: nothing usable was measured.")), card("Coverage", covered.figure, notes.covered)));
  return { root: controls, theta, theta_exact, phi, phiField, channel, scaling, slices, overlay, outside, measured, lobe, slice, image, covered, notes };
}

/** Fits made since are on offer, too. */
export function reopened(now) {
  if (parts?.names) beside(now.table);
}

async function beside(table) {
  const fits = await fitsOf(table);
  if (shown.table !== table) return;
  parts.overlay.replaceChildren(el("option", { value: "" }, "nothing"), ...fits.map((fit) => el("option", { value: fit.id }, `fit: ${fit.model}`)));
  parts.overlay.value = state().overlay;
}

async function prepare(now) {
  const mine = parts;
  await fill(parts.slice.box, "Opening the measurement …", async () => {
    const { description } = await get(`/v1/tables/${now.table}`);
    if (mine !== parts) return;
    const names = description.channels.map((c) => c.name);
    const colour = ["R", "G", "B"].every((name) => names.includes(name));
    parts.channel.replaceChildren(el("option", { value: "all" }, colour ? "all, as colour" : names.length > 1 ? "all (images: their mean)" : "the only one"), ...(names.length > 1 ? names.map((name) => el("option", { value: name }, name)) : []));
    parts.phiField.hidden = description.symmetry === "isotropic";
    parts.inPlane = description.domain.in_plane;
    parts.measured.replaceChildren(...description.peaks.slice(0, 10).map(({ theta_i_deg: t }) => el("button", { type: "button", onclick: () => set({ theta_i: String(Number(t.toFixed(3))) }) }, `θ_i = ${degrees(t)}`)));
    await beside(now.table);
    mine.names = names;
  });
  if (mine !== parts || !parts.names) return;
  whole(chosenOf(state()));
  update(state());
}

/** The state with a channel that this measurement has. */
const chosenOf = (now) => ({ ...now, channel: parts.names.includes(now.channel) ? now.channel : "all" });

function update(given) {
  if (!parts.names) return;
  const now = chosenOf(given);
  const { theta, theta_exact, phi, channel, scaling, slices, overlay, outside } = parts;
  for (const [control, value] of [[theta, now.theta_i], [theta_exact, now.theta_i], [phi, now.phi_i], [channel, now.channel], [scaling, now.scale], [slices, now.slices], [overlay, now.overlay]]) {
    if (control !== document.activeElement || control === theta) control.value = value;
  }
  theta.setAttribute("aria-valuetext", `${now.theta_i} degrees`);
  outside.checked = now.outside === "1";
  const here = JSON.stringify([now.theta_i, now.phi_i, now.channel, now.scale, now.slices, now.overlay, now.outside]);
  if (here === shown.here) return;
  const asIs = JSON.stringify([now.channel, now.scale]);
  if (shown.asIs && asIs !== shown.asIs) whole(now);
  Object.assign(shown, { here, asIs });
  clearTimeout(waiting);
  waiting = setTimeout(() => incidence(now), PATIENCE);
}

async function incidence(now) {
  stopping?.abort();
  stopping = new AbortController();
  const options = { panel: "look", signal: stopping.signal };
  const at = `theta_i_deg=${Number(now.theta_i)}&phi_i_deg=${Number(now.phi_i)}`;
  const { lobe, slice, notes } = parts;
  fill(lobe.box, "", async () => {
    if (parts.inPlane) {
      lobe.box.replaceChildren(el("p", { class: "quiet" }, "It was measured in the plane of incidence only: there is no lobe to show."));
      return;
    }
    const found = await get(`/v1/tables/${now.table}/lobe?${at}`, options);
    const { empty, scaled } = await drawLobe(lobe.box, found, { choice: now.channel, scaling: now.scale, outside: now.outside === "1" });
    lobe.head.textContent = `Radius and colour: f_r / (1/sr), ${inWords(now.scale)}, up to ${number(scaled.high, 3)}`;
    notes.lobe.textContent = empty ? "Nothing was measured at this incidence: take one within the domain, or show what was not measured, too." : "Drag to turn, or use the buttons. Orange: the light; dashed: the mirror direction.";
  });
  fill(slice.box, "", async () => {
    const found = await get(`/v1/tables/${now.table}/slices?${at}&n=359`, options);
    const curves = byChannel("", found.channels, now.channel, found.theta_o_deg, found.values, { outside: found.extrapolated });
    if (now.overlay) curves.push(...await model(now, found, options));
    await drawSlices(slice.box, curves, {
      polar: now.slices === "polar", scaling: now.scale, thetas: [Number(now.theta_i)],
      about: `In-plane slice at an incidence of ${now.theta_i}°, ${inWords(now.scale)} scale: ${curves.map((curve) => curve.name).join(", ")}.`,
    });
    slice.head.textContent = now.slices === "polar" ? `Radius: f_r / (1/sr), ${inWords(now.scale)}; angle: θ_o, the specular side on the right` : `f_r, ${inWords(now.scale)}`;
    notes.slice.textContent = `Dotted: nothing was measured there. Orange: the light; dashed: the mirror direction.${found.channels.length > 7 ? " Of many channels the first seven are shown." : ""}`;
  });
}

/** The fit that is laid beside the data, in the directions of a slice. */
async function model(now, found, options) {
  const rad = Math.PI / 180;
  const [t, p] = [now.theta_i * rad, now.phi_i * rad];
  const wo = found.theta_o_deg.map((x) => [-Math.sin(x * rad) * Math.cos(p), -Math.sin(x * rad) * Math.sin(p), Math.cos(x * rad)]);
  const said = await post(`/v1/models/${now.overlay}/evaluate`, { wi: [Math.sin(t) * Math.cos(p), Math.sin(t) * Math.sin(p), Math.cos(t)], wo }, options);
  return byChannel("fit", said.channels, now.channel, found.theta_o_deg, said.values).map((curve, k) => ({ ...curve, dash: "dash", colour: said.channels.length > 1 ? curve.colour : COLOURS[1 + k] }));
}

function whole(now) {
  const { image, covered, notes } = parts;
  fill(image.box, "", async () => {
    const found = await get(`/v1/tables/${now.table}/half-difference`, { panel: "look" });
    await drawHalfDifference(image.box, found, { choice: now.channel, scaling: now.scale });
  });
  fill(covered.box, "", async () => {
    const found = await get(`/v1/tables/${now.table}/coverage`, { panel: "look" });
    const masked = await drawCoverage(covered.box, found);
    notes.covered.textContent = `${number(found.looked_at)} usable samples counted of ${number(found.samples)} in all; grey: none.${masked ? " Orange: masked samples only." : ""}`;
  });
}
