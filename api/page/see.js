// The panel "See": a shape made of the raw table and of a fit, their difference, and the plan of effects.

import { card, el, facts, field, fill, grid, number, percent, problem, select } from "./dom.js";
import { start } from "./events.js";
import { fitsOf, given } from "./fits.js";
import { forget, get, recordStarted, request } from "./http.js";
import { watchJob } from "./progress.js";
import { LIGHTS, SHAPES, scene } from "./scenes.js";
import { set, state } from "./state.js";

let shown = {};
let parts = null;
let stopping = null;

export function show(root, now) {
  if (!parts?.asked.isConnected || shown.table !== now.table) {
    forget("see");
    stopping?.abort();
    shown = { table: now.table };
    parts = { asked: el("div", {}), progress: el("div", {}), pictures: el("div", {}) };
    root.replaceChildren(el("h2", {}, "See it"), card("Scene", parts.asked, parts.progress), parts.pictures);
    fill(parts.asked, "Looking for fits …", () => asking(now));
  }
  const here = [now.picture, now.pictured].join();
  if (shown.here !== here) {
    shown.here = here;
    if (now.picture || now.pictured) fill(parts.pictures, "Fetching the pictures …", () => pictures(now));
    else parts.pictures.replaceChildren();
  }
}

/** Fits made since are on offer, too. */
export async function reopened(now) {
  if (!parts?.offered || parts.busy) return;
  const there = (await fitsOf(now.table)).map((one) => one.id).join();
  if (shown.table === now.table && there !== parts.offered) fill(parts.asked, "", () => asking(now));
}

async function asking(now) {
  const [fits, table] = await Promise.all([fitsOf(now.table), get(`/v1/tables/${now.table}`)]);
  parts.offered = fits.map((one) => one.id).join();
  const fit = select([...fits.map((one) => [one.id, `${one.model}, ${new Date(one.created).toLocaleTimeString()}`]), ["", "none: the raw table alone"]], now.fit || fits.find((one) => one.job === now.job)?.id || fits[0]?.id || "");
  const shape = select(SHAPES, now.shape, (value) => set({ shape: value })), light = select(LIGHTS, now.light, (value) => set({ light: value }));
  const samples = select([["4", "4, a sketch"], ["16", "16"], ["64", "64"], ["256", "256, slow"]], "16");
  const tolerance = select([["0.001", "0.1 %"], ["0.01", "1 %"], ["0.1", "10 %"], ["", "nothing is left out"]], "0.01");
  const outcome = el("div", {});
  const submit = el("button", { type: "submit", class: "main" }, "Render");
  const send = async (event) => {
    event.preventDefault();
    stopping?.abort();
    stopping = new AbortController();
    const { signal } = stopping, mine = parts;
    submit.disabled = true;
    mine.busy = true;
    outcome.replaceChildren();
    const boxes = [el("div", {}), el("div", {})];
    mine.progress.replaceChildren(...boxes);
    const render = async (box, channels, material, planned, title) => {
      const made = scene(shape.value, light.value, material, channels);
      const wanted = { scene: { ...made, ...(planned && { tolerance: Number(tolerance.value) }) }, samples: Number(samples.value), seconds: 120, seed: 1, plan: planned };
      return (await watchJob(box, await start("scenes/render", wanted, "see"), title, signal)).results[0].id;
    };
    try {
      // One after the other: each takes every core there is.
      const channels = fit.value ? (await get(`/v1/models/${fit.value}`)).channels : table.description.channels.map((c) => c.name);
      const picture = await render(boxes[0], channels, { table: now.table }, false, "picture of the raw table");
      const pictured = fit.value ? await render(boxes[1], channels, { fit: fit.value }, tolerance.value !== "", "picture of the fit") : "";
      // Unless another table is shown by now.
      if (!signal.aborted && state().table === now.table) set({ picture, pictured, fit: fit.value });
    } catch (error) {
      if (error.name !== "AbortError") outcome.replaceChildren(problem(error));
    }
    submit.disabled = false;
    mine.busy = false;
  };
  return el("form", { onsubmit: send },
    el("div", { class: "controls" }, field("Fit", fit), field("Shape", shape), field("Light", light), field("Samples a pixel", samples), field("Leave out effects below", tolerance), el("div", { class: "field" }, submit)), outcome);
}

async function pictures({ picture, pictured }) {
  const raw = await get(`/v1/scenes/${picture}`, { panel: "see" });
  if (!pictured) {
    const image = await bitmap(`/v1/scenes/${picture}/picture.png`);
    recordStarted("see", "/v1/scenes/render", [given((await get(raw.links.job)).request)]);
    return [card("Picture", el("div", { class: "pictures" }, cut(image, 0, image.width, "the raw table")), told(raw))];
  }
  const [fit, difference, image] = await Promise.all([
    get(`/v1/scenes/${pictured}`, { panel: "see" }), get(`/v1/scenes/${picture}/difference/${pictured}`, { panel: "see" }), bitmap(`/v1/scenes/${picture}/difference/${pictured}/picture.png`),
  ]);
  const [{ request: first }, { request: asked }] = await Promise.all([get(raw.links.job), get(fit.links.job)]);
  recordStarted("see", "/v1/scenes/render", [given(first), given(asked)]);
  const model = (await get(`/v1/models/${asked.scene.materials.sample.fit}`)).name;
  const wide = (image.width - 4) / 3;
  const names = ["the raw table", model, `${model} less table, fourfold around grey`];
  return [
    card("Pictures", el("div", { class: "pictures" }, names.map((name, k) => cut(image, k * (wide + 2), wide, name))),
      grid("How far the fit is from the table, over the mean radiance F", ["channel", "rms difference", "of it noise", "without noise", "bias", "PSNR / dB"],
        difference.numbers.map((one) => [one.channel, percent(one.error), percent(one.noise), percent(one.error_without_noise), percent(one.bias), number(one.psnr_db, 3)])),
      el("div", { class: "two" }, el("div", {}, el("h4", {}, "The raw table"), told(raw)), el("div", {}, el("h4", {}, model), told(fit)))),
    card("Which effects were on, and why", plan(fit.plan)),
  ];
}

const told = (picture) => [
  facts([["Samples a pixel", number(picture.samples)], ["Error of a pixel", `${percent(picture.error, 2)} of F (standard error, rms)`], ["Time", `${number(picture.seconds, 3)} s, stopped by ${picture.stopped}`]]),
  picture.notes.length ? el("ul", {}, picture.notes.map((note) => el("li", {}, note))) : "",
].flat();

function plan(found) {
  if (!found) return el("p", {}, "All of them: nothing was to be left out.");
  const saved = found.operations?.saved;
  return [
    el("p", {}, `Within a tolerance of ${percent(found.tolerance)}, all that is left out together changes no point by more than ${percent(found.bound, 2)}.${saved ? ` That is ${number(saved, 3)} times fewer operations.` : ""}`),
    grid("Effects", ["effect", "was", "verdict", "why"], found.decisions.map((one) => [one.effect, one.off ? "off" : "on", one.state, one.sentence])),
  ].flat();
}

async function bitmap(path) {
  const answer = await request(path, { panel: "see" });
  return createImageBitmap(await answer.blob());
}

/** A part of an image, twice its size with sharp pixels. */
function cut(image, from, width, name) {
  const canvas = el("canvas", { width, height: image.height, role: "img", "aria-label": `Rendered picture: ${name}` });
  canvas.getContext("2d").drawImage(image, from, 0, width, image.height, 0, 0, width, image.height);
  return el("figure", {}, canvas, el("figcaption", {}, name));
}
