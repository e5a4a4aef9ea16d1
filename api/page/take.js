// The panel "Take away": reports, files, the link, and the commands that make what is on the screen.

import { button, card, el, field, fill, problem, say, select } from "./dom.js";
import { commands } from "./commands.js";
import { curl, download, get, key, local, recorded } from "./http.js";
import { fitsOf } from "./fits.js";
import { leftPanel, link, set } from "./state.js";

const PANELS = [["table", "Measurement"], ["look", "Look"], ["fit", "Fit"], ["see", "See"]];

let shown = null;

export function show(root, now) {
  const here = JSON.stringify([now.table, now.fit, now.job, now.posterior, now.tradeoff, now.picture]);
  if (shown === here && root.querySelector("h2")) return;
  shown = here;
  const box = el("div", {});
  root.replaceChildren(el("h2", {}, "Take it away"), box);
  fill(box, "Looking what there is …", () => everything(now));
}

async function everything(now) {
  const [table, fits, targets] = await Promise.all([get(`/v1/tables/${now.table}`), fitsOf(now.table), get("/v1/export-targets")]);
  const fit = fits.find((one) => one.id === now.fit) || fits.findLast((one) => one.job === now.job) || fits[0];
  const command = await commands(now, table, fit);
  return [
    el("div", { class: "two" }, card("Report", reports(fits, fit, now)), card("Export", exporting(targets, table, fit, now))),
    card("This view", el("p", {}, "A link reopens what is on the screen, for who may read it:"), copied(new URL(link({ panel: leftPanel() }), location.href).href, "link")),
    card("The same from a terminal", command.length ? copied(command.join("\n"), "commands") : el("p", { class: "quiet" }, "Nothing yet."), el("p", { class: "quiet" }, "A key, where one is needed, is taken from BRDF_FITTER_KEY.")),
    ...calls(),
  ];
}

function reports(fits, fit, now) {
  if (!fit) return el("p", { class: "quiet" }, "There is no fit yet.");
  const chosen = select(fits.map((one) => [one.id, `${one.model}, ${new Date(one.created).toLocaleTimeString()}`]), fit.id, (value) => set({ fit: value }));
  const base = `/v1/fits/${fit.id}/report`;
  const outcome = el("div", { role: "status" });
  const save = (path, name) => button(name, () => saved(outcome, path, name));
  const open = key() ? save(`${base}.html`, "report.html") : el("a", { class: "button main", href: local(`${base}.html`), target: "_blank", rel: "noopener" }, "Open the report");
  const posterior = now.posterior || "";
  return [
    field("Fit", chosen),
    el("p", { class: "row" }, open, save(`${base}.pdf`, "report.pdf"), save(`${base}.json`, "report.json"), save(`/v1/fits/${fit.id}`, "fit.json"), posterior && save(`/v1/posteriors/${posterior}`, "posterior.json")), outcome,
  ];
}

function exporting(targets, table, fit, now) {
  const list = (what) => targets.filter((target) => target[what]).map((target) => [`${what}/${target.name}`, `${what === "models" ? "fit" : "table"} → ${target.name}: ${target.description}`]);
  const target = select([...(fit ? list("models") : []), ...list("tables")], "models/glsl");
  const outcome = el("div", { role: "status" });
  const send = (event) => {
    event.preventDefault();
    const [what, name] = target.value.split("/");
    saved(outcome, `/v1/${what}/${what === "models" ? fit.id : now.table}/export/${name}`, `${table.name}.${name}`);
  };
  return el("form", { onsubmit: send }, field("What, and as what", target), el("p", {}, el("button", { type: "submit", class: "main" }, "Export")), outcome);
}

async function saved(outcome, path, name) {
  outcome.replaceChildren(el("p", { class: "quiet waiting" }, `Making ${name} …`));
  try {
    const answer = await download(path, name, { panel: "take" });
    const { notes } = JSON.parse(answer.headers.get("export-notes") || "{}");
    outcome.replaceChildren(el("p", {}, `${name} was saved.`), notes?.length ? el("ul", {}, notes.map((note) => el("li", {}, typeof note === "string" ? note : note.sentence || note.text || JSON.stringify(note)))) : "");
  } catch (error) {
    outcome.replaceChildren(problem(error));
  }
}

/** What each panel asked the service for. */
function calls() {
  return [...PANELS, ["take", "Take away"]].filter(([name]) => recorded(name).length).map(([name, title]) => card(`HTTP calls behind “${title}”`, copied(recorded(name).map(curl).join("\n"), `calls of ${title}`)));
}

function copied(text, name) {
  const copy = button("Copy", async () => {
    await navigator.clipboard.writeText(text);
    copy.textContent = "Copied";
    say(`${name} copied`);
  }, { "aria-label": `Copy the ${name}` });
  return el("div", { class: "copied" }, el("pre", { tabindex: "0", "aria-label": name, role: "region" }, text), copy);
}
