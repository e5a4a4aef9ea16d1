// State: what the page shows. It is the address's query, so that a link reopens the same view.

const DEFAULTS = {
  panel: "table", table: "", before: "", theta_i: "45", phi_i: "0", channel: "all", scale: "cbrt", slices: "polar",
  outside: "", overlay: "", job: "", fit: "", posterior: "", tradeoff: "", incidence: "", residuals: "",
  shape: "sphere", light: "sun", picture: "", pictured: "",
};
/** What belongs to one table. */
const OF_TABLE = ["before", "overlay", "job", "fit", "posterior", "tradeoff", "picture", "pictured"];
/** What names something of the service, and so becomes part of a request's path. */
const IDS = ["table", ...OF_TABLE];
const listeners = [];
let left = "look";

/** Everything, as strings; what the address does not say has its default, and so has an id that can't be one. */
export function state() {
  const said = [...new URLSearchParams(location.search)].filter(([name, value]) => !IDS.includes(name) || /^\w*$/.test(value));
  return { ...DEFAULTS, ...Object.fromEntries(said) };
}

/** What changes with the table: nothing of the one before is left. */
export const ofTable = (table, before = "") => ({ ...Object.fromEntries(OF_TABLE.map((name) => [name, ""])), table, before });

/** Change some of it. A step (another panel, another table) can be gone back from; a slider's can't. */
export function set(changes, step = false) {
  const old = state();
  if (changes.panel && old.panel !== changes.panel) left = old.panel;
  const now = { ...old, ...changes };
  const address = addressOf(now);
  if (address === location.pathname + location.search) return;
  history[step ? "pushState" : "replaceState"](null, "", address);
  tell();
}

/** The panel that was left last. */
export const leftPanel = () => left;

/** The link to a state with these changes. */
export function link(changes) {
  return addressOf({ ...state(), ...changes });
}

function addressOf(now) {
  const kept = Object.entries(now).filter(([name, value]) => value !== DEFAULTS[name] && name in DEFAULTS);
  const query = new URLSearchParams(kept).toString();
  return location.pathname + (query ? `?${query}` : "");
}

/** Call back at every change. */
export function watch(listener) {
  listeners.push(listener);
}

function tell() {
  const now = state();
  for (const listener of listeners) listener(now);
}

addEventListener("popstate", tell);
