// Requests to the service: the key, problems as errors, downloads, and a record of calls for "Take it away".

import { askKey } from "./key.js";

const KEY = "brdf-fitter-key";
const records = new Map();

/** A problem document (RFC 9457) as an error. */
export class Problem extends Error {
  constructor(document) {
    super(document.detail || document.title || "the request failed");
    this.document = document;
  }
}

export const key = () => sessionStorage.getItem(KEY) || "";

export function useKey(value) {
  if (value) sessionStorage.setItem(KEY, value);
  else sessionStorage.removeItem(KEY);
}

/** An absolute path of the service, as links are, relative to where the page is served. */
export const local = (path) => new URL(path.replace(/^\//, ""), document.baseURI).href;

function headers(more = {}) {
  return key() ? { ...more, Authorization: `Bearer ${key()}` } : more;
}

/** The answer. Raises Problem; asks for a key where the service does. */
export async function request(path, { method = "GET", json, accept, panel, signal, headers: more } = {}) {
  const sent = headers({ ...more, ...(accept && { Accept: accept }), ...(json && { "Content-Type": "application/json" }) });
  let answer;
  try {
    answer = await fetch(local(path), { method, headers: sent, signal, body: json && JSON.stringify(json), cache: "no-cache" });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem({ title: "No answer", detail: `the service does not answer: ${error.message}`, remedy: "look whether it still runs, then try again" });
  }
  if (answer.status === 401) {
    const problem = await problemOf(answer);
    if (await askKey(problem.message)) return request(path, { method, json, accept, panel, signal, headers: more });
    throw problem;
  }
  if (!answer.ok) throw await problemOf(answer);
  if (panel) record(panel, { method, path, json, accept });
  return answer;
}

export const get = async (path, options) => (await request(path, options)).json();
export const post = async (path, json, options) => (await request(path, { ...options, method: "POST", json })).json();

async function problemOf(answer) {
  const text = await answer.text();
  try {
    return new Problem(JSON.parse(text));
  } catch {
    return new Problem({ status: answer.status, title: answer.statusText || `Status ${answer.status}`, detail: text.slice(0, 300) });
  }
}

/** Upload a file; `progress` is told the share sent. Raises Problem. */
export function upload(path, file, progress) {
  return new Promise((resolve, reject) => {
    const sender = new XMLHttpRequest();
    sender.open("POST", local(path));
    for (const [name, value] of Object.entries(headers())) sender.setRequestHeader(name, value);
    sender.upload.onprogress = (event) => event.lengthComputable && progress(event.loaded / event.total);
    sender.onerror = () => reject(new Problem({ title: "No answer", detail: "the upload was cut off", remedy: "try again" }));
    sender.onload = async () => {
      const answer = new Response(sender.responseText, { status: sender.status, statusText: sender.statusText });
      if (answer.ok) resolve(await answer.json());
      else if (answer.status === 401) {
        const problem = await problemOf(answer);
        if (await askKey(problem.message)) resolve(upload(path, file, progress));
        else reject(problem);
      } else reject(await problemOf(answer));
    };
    sender.send(file);
  });
}

/** Save an answer as a file; with a key a plain link would not do. */
export async function download(path, name, options) {
  const answer = await request(path, options);
  const said = /filename="?([^";]+)/.exec(answer.headers.get("content-disposition") || "");
  const address = URL.createObjectURL(await answer.blob());
  const anchor = document.createElement("a");
  anchor.href = address;
  anchor.download = said ? said[1] : name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
  return answer;
}

/** Remember a call that made what a panel shows; of the same question only the last answer counts. */
export function record(panel, call) {
  if (!records.has(panel)) records.set(panel, new Map());
  const calls = records.get(panel);
  const [path] = call.path.split("?");
  const name = `${call.method} ${path}${call.json && !path.endsWith("/evaluate") ? JSON.stringify(call.json) : ""}`;
  calls.delete(name);
  calls.set(name, call);
}

/** The calls that once started what a reopened link shows, from the requests of their jobs. */
export function recordStarted(panel, path, requests) {
  if (recorded(panel).some((call) => call.method === "POST" && call.path === path)) return;
  for (const json of requests) record(panel, { method: "POST", path, json });
}

/** The calls of a panel in the order they were made. */
export const recorded = (panel) => [...(records.get(panel)?.values() || [])];

/** Forget the calls of a panel: another table is shown. */
export const forget = (panel) => records.delete(panel);

/** A call as a command. */
export function curl({ method, path, json, accept, file }) {
  const words = ["curl", "-sf"];
  if (key()) words.push("-H", '"Authorization: Bearer $BRDF_FITTER_KEY"');
  if (accept) words.push("-H", quoted(`Accept: ${accept}`));
  if (file) words.push("--data-binary", quoted(`@${file}`));
  if (json) words.push("--json", quoted(JSON.stringify(json)));
  else if (method !== "GET" && !file) words.push("-X", method);
  words.push(quoted(local(path)));
  return words.join(" ");
}

/** For a POSIX shell. */
export const quoted = (text) => `'${String(text).replaceAll("'", "'\\''")}'`;
