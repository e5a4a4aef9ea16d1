// Commands of `brdf-fitter` that do what was done on the page, by the same service.

import { get, quoted } from "./http.js";
import { requestOf } from "./fits.js";

/** A list of shell lines. */
export async function commands(now, table, fit) {
  const here = document.baseURI.replace(/[?#].*$/, "").replace(/\/$/, "");
  const call = `brdf-fitter --server ${quoted(here)}`;
  const lines = [`${call} info ${table.id}`, `${call} check ${table.id}`];
  const job = now.job || fit?.job ? await get(`/v1/jobs/${now.job || fit.job}`) : null;
  if (job) {
    lines.push(`${call} fit ${table.id}${fitting(job)} --out fits`);
  }
  if (fit) {
    const stem = `fits/${fit.model.replaceAll(":", "-")}.json`;
    const made = now.posterior ? await get(`/v1/posteriors/${now.posterior}`) : null;
    if (made) lines.push(`${call} posterior ${stem} --ess ${made.spec.ess} --budget-seconds ${made.spec.budget_seconds} --out posterior.json`);
    lines.push(`${call} report ${stem} --out report`);
    lines.push(`brdf-fitter export ${stem} --to glsl --out ${fit.model.replaceAll(":", "-")}.glsl`);
  }
  return lines;
}

function fitting(job) {
  const wanted = requestOf(job);
  const words = [];
  if (wanted.model === "auto") {
    words.push("--model auto");
    const ranking = job.results.find((one) => one.kind === "selection")?.ranking;
    if (wanted.candidates && ranking) words.push(`--candidates ${ranking.map((one) => quoted(one.model)).join(",")}`);
    if (wanted.folds) words.push(`--folds ${wanted.folds}`);
  } else {
    const names = job.results.filter((one) => one.kind === "fit").map((one) => one.model);
    for (const name of names) words.push(`--model ${quoted(name)}`);
  }
  if (wanted.metric) words.push(`--metric ${wanted.metric}`);
  if (wanted.budget_seconds) words.push(`--budget ${wanted.budget_seconds}s`);
  if (wanted.seed) words.push(`--seed ${wanted.seed}`);
  return words.map((word) => ` ${word}`).join("");
}
