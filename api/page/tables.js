// The panel "Measurement": upload, what was understood, and what to correct.

import { card, el, field, fill, number, problem, say, select } from "./dom.js";
import { get, record, upload } from "./http.js";
import { link, ofTable, set, state } from "./state.js";
import { understood } from "./understood.js";
import { OPTIONS } from "./reading.js";

let shown = null;
let list;
let detail;

export function show(root, now) {
  if (!list?.isConnected) {
    list = el("div", { class: "list" });
    detail = el("div", { class: "detail" });
    shown = null;
    root.replaceChildren(el("div", { class: "sided" }, el("div", {}, uploading(), card("Measurements", list)), detail));
    listed();
  }
  if (shown !== now.table + now.before) {
    shown = now.table + now.before;
    mark(now.table);
    if (now.table) fill(detail, "Reading the measurement …", () => understood(now.table, now.before));
    else detail.replaceChildren(el("p", { class: "quiet" }, "Choose a measurement, or drop a file: what was understood of it shows here."));
  }
}

function listed() {
  return fill(list, "Looking for measurements …", async () => {
    const { items, total } = await get("/v1/tables?limit=50");
    if (!items.length) return el("p", { class: "quiet" }, "None yet.");
    return [el("ul", {}, items.map(entry)), total > items.length && el("p", { class: "quiet" }, `the newest ${items.length} of ${total}`)].filter(Boolean);
  }).then(() => mark(state().table));
}

function entry(table) {
  const { format, usable, samples, channels } = table.description;
  const open = (event) => {
    event.preventDefault();
    set(ofTable(table.id), true);
  };
  return el("li", {}, el("a", { href: link(ofTable(table.id)), onclick: open, "data-id": table.id }, table.name), " ",
    el("small", { class: "quiet" }, `${format}, ${number(usable)} of ${number(samples)} samples, ${channels.length} channel${channels.length > 1 ? "s" : ""}`));
}

function mark(id) {
  for (const anchor of list.querySelectorAll("a")) {
    if (anchor.dataset.id === id) anchor.setAttribute("aria-current", "true");
    else anchor.removeAttribute("aria-current");
  }
}

function uploading() {
  const input = el("input", { type: "file", id: "file", class: "over", onchange: () => input.files[0] && send(input.files[0]) });
  const zone = el("label", { for: "file", class: "drop" }, el("strong", {}, "Drop a file here"), " or choose one", el("br"),
    el("small", { class: "quiet" }, "The format is told by its content."), input);
  const progress = el("progress", { max: 1, value: 0, hidden: true, "aria-label": "share of the file that was sent" });
  const outcome = el("div", {});
  const controls = Object.fromEntries(Object.entries(OPTIONS).map(([name, option]) => [name, select([["", option.asIs], ...option.values], "")]));
  const item = el("input", { type: "text", spellcheck: "false" });
  const options = el("details", {}, el("summary", {}, "What the file can't say about itself"),
    Object.entries(OPTIONS).map(([name, option]) => field(option.label, controls[name])), field("Which table of the file", item, "its name or its position from 0, where a file holds several"));

  async function send(file) {
    const query = new URLSearchParams({ name: file.name.replace(/\.[^.]*$/, "").slice(0, 200) || file.name.slice(0, 200) });
    for (const [name, control] of Object.entries(controls)) if (control.value) query.set(name, control.value);
    if (item.value) query.set("item", item.value);
    progress.hidden = false;
    progress.value = 0;
    outcome.replaceChildren(el("p", { class: "quiet" }, `Sending ${file.name} …`));
    try {
      const path = `/v1/tables?${query}`;
      const table = await upload(path, file, (share) => {
        progress.value = share;
        if (share === 1) outcome.replaceChildren(el("p", { class: "quiet" }, `Reading ${file.name} …`));
      });
      record("table", { method: "POST", path, file: file.name });
      outcome.replaceChildren(el("p", {}, `${file.name} was read.`));
      say(`${file.name} was read as ${table.description.format}`);
      listed();
      set(ofTable(table.id), true);
    } catch (error) {
      outcome.replaceChildren(problem(error));
    }
    progress.hidden = true;
    input.value = "";
  }

  for (const name of ["dragenter", "dragover"]) zone.addEventListener(name, (event) => { event.preventDefault(); zone.classList.add("over"); });
  for (const name of ["dragleave", "drop"]) zone.addEventListener(name, () => zone.classList.remove("over"));
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    const [file] = event.dataTransfer.files;
    if (file) send(file);
  });
  return card("Upload", zone, progress, outcome, options);
}

/** After a correction: the new reading is in the list, too. */
export const again = () => list?.isConnected && listed();

