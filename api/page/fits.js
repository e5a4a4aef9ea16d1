// The fits of a table.

import { get } from "./http.js";

/** The newest finished fits of a table. */
export async function fitsOf(table) {
  const { items } = await get("/v1/fits?limit=200");
  return items.filter((fit) => fit.table === table);
}

/** The jobs of a table and kind, newest first. */
export async function jobsOf(table, kind) {
  const { items } = await get("/v1/jobs?limit=100");
  return items.filter((job) => job.table === table && job.kind === kind);
}

/** The fits that a finished job made, whole. */
export async function fitsOfJob(job, panel) {
  const made = job.results.filter((one) => one.kind === "fit" && one.id);
  return Promise.all(made.map((one) => get(`/v1/fits/${one.id}`, { panel })));
}

/** The request that starts a fit job again. */
export function requestOf(job) {
  const { specs, selection } = job.request;
  const lean = (spec) => Object.fromEntries(Object.entries(spec).filter(([, value]) => value !== null && !(typeof value === "object" && !Array.isArray(value) && !Object.values(value).some((v) => v !== null))));
  if (selection) return { table: job.table, ...lean(selection), model: "auto" };
  const { model, ...rest } = specs[0];
  return { table: job.table, models: specs.map((spec) => spec.model), ...lean(rest) };
}

/** The name of a model specification is not in it: a job's results have it, and what waits is told by its family. */
export const nameOf = (spec) => (typeof spec === "string" ? spec : spec.lobes > 1 ? `${spec.family}:${spec.lobes}` : spec.family);
