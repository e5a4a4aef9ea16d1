// Elements, and the words for problems.

/** An element: attributes, listeners (onclick), and children, of which text becomes text and nothing else. */
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name in made && typeof value !== "string") made[name] = value;
    else if (value !== undefined && value !== null && value !== false) made.setAttribute(name, value);
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return made;
}

let fields = 0;

/** A labelled control. */
export function field(label, control, hint) {
  control.id ||= `field-${++fields}`;
  const parts = [el("label", { for: control.id }, label), control];
  if (hint) {
    const said = el("small", { id: `${control.id}-hint`, class: "quiet" }, hint);
    control.setAttribute("aria-describedby", said.id);
    parts.push(said);
  }
  return el("div", { class: "field" }, parts);
}

/** A select; options are values or [value, label]. */
export function select(options, value, onchange) {
  const made = el("select", { onchange: () => onchange?.(made.value) });
  for (const option of options) {
    const [given, label] = Array.isArray(option) ? option : [option, option];
    made.append(el("option", { value: given }, label));
  }
  made.value = value;
  if (made.selectedIndex < 0 && made.options.length) made.selectedIndex = 0;
  return made;
}

export const button = (text, onclick, attributes = {}) => el("button", { type: "button", onclick, ...attributes }, text);

/** Terms and what they are; pairs without a value are left out. */
export function facts(pairs) {
  const shown = pairs.filter(([, value]) => value !== null && value !== undefined && value !== "");
  return el("dl", {}, shown.flatMap(([term, value]) => [el("dt", {}, term), el("dd", {}, value)]));
}

/** A table in a box that scrolls. `rows` of cells; the first of each is its header. */
export function grid(caption, head, rows) {
  const cells = (row) => row.map((cell, k) => (k ? el("td", { class: String(cell).length > 40 ? "words" : null }, cell) : el("th", { scope: "row" }, cell)));
  return el("div", { class: "scroll", role: "region", tabindex: "0", "aria-label": caption },
    el("table", {}, el("caption", {}, caption),
      el("thead", {}, el("tr", {}, head.map((cell) => el("th", { scope: "col" }, cell)))),
      el("tbody", {}, rows.map((row) => el("tr", {}, cells(row))))));
}

/** A titled part of a panel. */
export function card(title, ...children) {
  return el("section", { class: "card" }, el("h3", {}, title), ...children);
}

/** A problem in its own words. */
export function problem(error) {
  const said = error.document || { title: "The page failed", detail: String(error.message || error) };
  if (!error.document) console.error(error);
  const place = ["file", "row", "column", "offset", "parameter"].filter((name) => said[name] !== undefined && said[name] !== null);
  return el("div", { class: "problem", role: "alert" },
    el("strong", {}, said.title || "It can't be done"), " ", el("span", {}, said.detail || ""),
    facts([
      ["Where", place.map((name) => `${name} ${said[name]}`).join(", ")],
      ["Cause", said.cause], ["Remedy", said.remedy], ["Code", said.code],
    ]));
}

/** Put the outcome of `work` into a box; meanwhile say `waiting`. */
export async function fill(box, waiting, work) {
  const turn = {};
  box.turn = turn;
  box.setAttribute("aria-busy", "true");
  if (waiting) box.replaceChildren(el("p", { class: "quiet waiting" }, waiting));
  try {
    const made = await work();
    if (box.turn === turn && made) replaced(box, [made].flat());
  } catch (error) {
    if (error.name !== "AbortError" && box.turn === turn) {
      // It is no picture any more, if it was one.
      for (const name of ["role", "aria-label"]) box.removeAttribute(name);
      box.replaceChildren(problem(error));
    }
  } finally {
    if (box.turn === turn) box.removeAttribute("aria-busy");
  }
}

/** Put other content into a box; the control that had the focus, or its successor, has it again. */
function replaced(box, content) {
  const controls = () => [...box.querySelectorAll("select, input, button")];
  const at = controls().indexOf(document.activeElement);
  box.replaceChildren(...content);
  if (at >= 0) controls()[at]?.focus();
}

/** Tell who listens to the page. */
export function say(text) {
  document.getElementById("said").textContent = text;
}

/** A number with so many significant digits, as people write it. */
export function number(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (Number.isInteger(value) && Math.abs(value) < 1e15) return value.toLocaleString("en");
  const rounded = Number(Number(value).toPrecision(digits));
  const size = Math.abs(rounded);
  return size >= 1e-5 && size < 1e7 ? rounded.toLocaleString("en", { maximumSignificantDigits: digits }) : rounded.toExponential().replace("e+", "e");
}

/** A share in percent. */
export const percent = (share, digits = 3) => (share === null || share === undefined ? "–" : `${number(100 * share, digits)} %`);
export const degrees = (value) => `${number(value, 4)}°`;
export const seconds = (value) => (value < 1 ? `${number(1000 * value, 2)} ms` : `${number(value, 3)} s`);
