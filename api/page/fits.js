// The fits of a table.

import { get } from "./http.js";

/** The newest finished fits of a table. */
export async function fitsOf(table) {
  return (await get(`/v1/fits?limit=100&table=${encodeURIComponent(table)}`)).items;
}

/** The jobs of a table and kind, newest first. */
export async function jobsOf(table, kind) {
  const { items } = await get(`/v1/jobs?limit=100&table=${encodeURIComponent(table)}`);
  return items.filter((job) => job.kind === kind);
}

/** The fits that a finished job made, whole. */
export async function fitsOfJob(job, panel) {
  const made = job.results.filter((one) => one.kind === "fit" && one.id);
  return Promise.all(made.map((one) => get(`/v1/fits/${one.id}`, { panel })));
}

/** The fields of a request that say something: not null, and no object of nulls. */
export function given(fields) {
  const says = (value) => value !== null && (typeof value !== "object" || Array.isArray(value) || Object.values(value).some(says));
  return Object.fromEntries(Object.entries(fields).filter(([, value]) => says(value)));
}

/** The request that starts a fit job again. */
export function requestOf(job) {
  const { specs, selection } = job.request;
  if (selection) return { table: job.table, ...given(selection), model: "auto" };
  const { model, ...rest } = specs[0];
  return { table: job.table, models: specs.map((spec) => spec.model), ...given(rest) };
}
