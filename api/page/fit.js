// The panel "Fit": what is asked for, its progress, and the results.

import { button, card, el, field, fill, problem, select } from "./dom.js";
import { start } from "./events.js";
import { jobsOf, requestOf } from "./fits.js";
import { forget, get, recordStarted } from "./http.js";
import { watchJob } from "./progress.js";
import { results } from "./results.js";
import { set, state } from "./state.js";

const METRICS = [
  ["", "the table's default"], ["measurement", "measurement: residuals over their uncertainties"], ["absolute", "absolute"], ["cosine", "cosine-weighted"],
  ["relative", "relative"], ["log", "logarithm"], ["cbrt", "cube root"],
];

let shown = {};
let parts = null;
let stopping = null;

export function show(root, now) {
  if (!parts?.asked.isConnected || shown.table !== now.table) {
    forget("fit");
    stopping?.abort();
    shown = { table: now.table };
    parts = { asked: el("div", {}), progress: el("div", {}), earlier: el("div", {}), outcome: el("div", {}) };
    root.replaceChildren(el("h2", {}, "Fit models"), el("div", { class: "two" }, card("What to fit", parts.asked), el("div", {}, card("Progress", parts.progress), card("Earlier fits of this measurement", parts.earlier))), parts.outcome);
    fill(parts.asked, "Looking for models …", () => asking(now.table));
    earlier(now.table);
    if (!now.job) parts.progress.replaceChildren(el("p", { class: "quiet" }, "Nothing runs."));
  }
  if (shown.job !== now.job) {
    shown.job = now.job;
    stopping?.abort();
    if (now.job) run(now.job);
    else parts.outcome.replaceChildren();
  } else if (shown.done) results(parts.outcome, shown.done, now);
}

async function asking(table) {
  const families = (await get("/v1/model-families")).filter((family) => family.fitted);
  const boxes = families.map((family) => el("input", { type: "checkbox", name: "model", value: family.name, checked: true }));
  const auto = el("input", { type: "checkbox", name: "model", value: "auto", onchange: () => { for (const box of [...boxes, more]) box.disabled = auto.checked; } });
  const more = el("input", { type: "text", spellcheck: "false", placeholder: "lafortune:2, ward:bounded" });
  const metric = select(METRICS, "");
  const budget = el("input", { type: "number", min: "0.1", max: "3600", step: "any" });
  const seed = el("input", { type: "number", min: "0", step: "1", value: "0" });
  const outcome = el("div", {});
  const send = async (event) => {
    event.preventDefault();
    const models = [...boxes.filter((box) => box.checked).map((box) => box.value), ...more.value.split(",").map((name) => name.trim()).filter(Boolean)];
    const wanted = { table, ...(auto.checked ? { model: "auto" } : { models }), seed: Number(seed.value) || 0 };
    if (metric.value) wanted.metric = metric.value;
    if (budget.value) wanted.budget_seconds = Number(budget.value);
    outcome.replaceChildren();
    try {
      begin(await start("fits", wanted, "fit"));
    } catch (error) {
      outcome.replaceChildren(problem(error));
    }
  };
  return el("form", { class: "stack", onsubmit: send },
    el("fieldset", {}, el("legend", {}, "Models"),
      families.map((family, k) => el("label", { class: "block" }, boxes[k], " ", el("strong", {}, family.name), " ", el("small", { class: "quiet" }, family.summary))),
      el("label", { class: "block" }, auto, " ", el("strong", {}, "auto"), " ", el("small", { class: "quiet" }, "compare models on scans held out, and take what the table supports")),
      field("Further models, by short name", more)),
    el("div", { class: "controls" }, field("Metric", metric), field("Budget / s a model", budget, "empty: no limit"), field("Seed", seed)),
    el("p", {}, el("button", { type: "submit", class: "main" }, "Fit")), outcome);
}

function begin(job) {
  set({ job: job.id, fit: "", posterior: "" }, true);
  earlier(job.table);
}

async function run(id) {
  stopping = new AbortController();
  const { signal } = stopping;
  shown.done = null;
  parts.outcome.replaceChildren();
  const { progress } = parts;
  try {
    const job = await get(`/v1/jobs/${id}`, { panel: "fit", signal });
    recordStarted("fit", "/v1/fits", [requestOf(job)]);
    const done = await watchJob(progress, job, title(job), signal);
    // Another job or table was chosen while another panel is shown.
    if (state().job !== id) {
      shown.job = null;
      return;
    }
    progress.replaceChildren(el("p", { class: "quiet" }, `${title(done)}: done.`), again(done));
    earlier(done.table);
    shown.done = done;
    results(parts.outcome, done, state());
  } catch (error) {
    if (error.name === "AbortError") return;
    const job = await get(`/v1/jobs/${id}`).catch(() => null);
    progress.replaceChildren(problem(error), job && again(job));
  }
}

const again = (job) => button("Run it again", async (event) => {
  event.target.disabled = true;
  await start("fits", requestOf(job), "fit").then(begin, (error) => parts.progress.append(problem(error)));
});

const title = (job) => {
  const names = job.results.filter((one) => one.kind === "fit").map((one) => one.model);
  const { specs, selection } = job.request;
  return selection ? "auto" : names.length ? names.join(", ") : specs.map((spec) => spec.model.family).join(", ");
};

function earlier(table) {
  return fill(parts.earlier, "", async () => {
    const jobs = await jobsOf(table, "fit");
    if (!jobs.length) return el("p", { class: "quiet" }, "None yet.");
    return el("ul", {}, jobs.slice(0, 8).map((job) => el("li", {}, button(title(job), () => set({ job: job.id, fit: "", posterior: "" }, true), { class: "link" }), " ", el("small", { class: "quiet" }, `${job.state}, ${new Date(job.created).toLocaleString()}`))));
  });
}
