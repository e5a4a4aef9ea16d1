// The page: its panels, and which of them is shown.

import { el, problem } from "./dom.js";
import { askKey } from "./key.js";
import { get } from "./http.js";
import { link, set, state, watch } from "./state.js";
import * as fit from "./fit.js";
import * as look from "./look.js";
import * as see from "./see.js";
import * as table from "./tables.js";
import * as take from "./take.js";

const PANELS = { table: ["Measurement", table], look: ["Look", look], fit: ["Fit", fit], see: ["See", see], take: ["Take away", take] };

const main = document.getElementById("main");
const nav = document.getElementById("panels");
const sections = {};
let named = null;
let last = null;

for (const [name, [title]] of Object.entries(PANELS)) {
  sections[name] = el("section", { id: `panel-${name}`, "aria-label": title, hidden: true });
  main.append(sections[name]);
  nav.append(el("a", { href: link({ panel: name }), "data-panel": name, onclick: (event) => {
    event.preventDefault();
    set({ panel: name }, true);
    main.focus({ preventScroll: true });
  } }, title));
}

function show(now) {
  const name = Object.hasOwn(PANELS, now.panel) ? now.panel : "table";
  const needed = name === "table" || now.table;
  for (const anchor of nav.children) {
    const here = anchor.dataset.panel === name;
    anchor.href = link({ panel: anchor.dataset.panel });
    if (here) anchor.setAttribute("aria-current", "page");
    else anchor.removeAttribute("aria-current");
    sections[anchor.dataset.panel].hidden = !here;
  }
  document.title = `${PANELS[name][0]} – brdf-fitter`;
  try {
    if (needed) PANELS[name][1].show(sections[name], now);
    else sections[name].replaceChildren(el("p", { class: "quiet" }, "Choose a measurement first."));
    // Something may have been made meanwhile.
    if (last !== name && needed) PANELS[name][1].reopened?.(now);
    last = name;
  } catch (error) {
    sections[name].replaceChildren(problem(error));
  }
  entitle(now.table);
}

async function entitle(id) {
  if (named === id) return;
  named = id;
  const subject = document.getElementById("subject");
  if (!id) {
    subject.textContent = "no measurement chosen";
    return;
  }
  try {
    const found = await get(`/v1/tables/${id}`);
    if (named === id) subject.textContent = found.name;
  } catch (error) {
    subject.textContent = error.message;
  }
}

document.getElementById("key").addEventListener("click", async () => {
  if (await askKey()) location.reload();
});

watch(show);
show(state());
