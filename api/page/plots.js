// Plots: Plotly, fetched when the first one is drawn; colours that the colour-blind can tell apart.

// M. Okabe and K. Ito (2008); line styles differ, too, so that no plot rests on colour alone.
export const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8a8a"];
export const DASHES = ["solid", "dash", "dot", "dashdot", "longdash", "longdashdot"];
export const MARKS = ["circle", "square", "diamond", "triangle-up", "cross", "x", "star"];
/** Of channels named R, G and B: their own hue where it can be told apart. */
const OF_CHANNELS = { R: "#d55e00", G: "#009e73", B: "#0072b2" };
export const SEQUENTIAL = "Viridis";
/** Blue, white, orange: around zero. */
export const DIVERGING = [[0, "#084594"], [0.25, "#6baed6"], [0.5, "#f7f7f7"], [0.75, "#fd8d3c"], [1, "#8c2d04"]];

export const colourOf = (channel, k) => OF_CHANNELS[channel] || COLOURS[k % COLOURS.length];

let loading = null;
const drawn = new Set();

/** Plotly, once. */
function plotly() {
  loading ??= new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = new URL("plotly.js", import.meta.url).href;
    script.onload = () => resolve(window.Plotly);
    script.onerror = () => {
      loading = null;
      reject(new Error("the plotting library could not be loaded; reload the page"));
    };
    document.head.append(script);
  });
  return loading;
}

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** The colours of text, grid and paper as they are now, light or dark. */
export const inks = () => ({ ink: css("--ink"), quiet: css("--quiet"), grid: css("--grid"), blank: css("--blank") });

const axis = ({ ink, grid }) => ({
  gridcolor: grid, zerolinecolor: grid, linecolor: ink, tickcolor: ink, ticks: "outside", ticklen: 4, automargin: true,
  title: { standoff: 8 },
});

/** A figure: a title, a box for the plot, and what stands below it. */
export function figure(title, ...below) {
  const made = document.createElement("figure");
  const head = document.createElement("figcaption");
  head.textContent = title;
  const box = document.createElement("div");
  box.className = "plot";
  made.append(head, box, ...below);
  return { figure: made, box, head };
}

/** Draw into a figure's box. `about` says in words what is drawn. */
export async function draw(box, traces, layout, about) {
  const Plotly = await plotly();
  const colours = inks();
  const whole = {
    font: { family: "system-ui, sans-serif", size: 12, color: colours.ink }, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    margin: { l: 56, r: 16, t: 8, b: 48 }, showlegend: false, hoverlabel: { font: { family: "system-ui, sans-serif" } },
    legend: { orientation: "h", y: 1.01, yanchor: "bottom", x: 0, font: { size: 11 } }, dragmode: "zoom", colorway: COLOURS, ...layout,
  };
  if (box.clientWidth < 450) Object.assign(whole.legend, { entrywidthmode: "fraction", entrywidth: 0.5 });
  for (const name of Object.keys(whole)) {
    if (/^[xy]axis\d*$/.test(name)) whole[name] = { ...axis(colours), ...whole[name], title: { standoff: 8, ...whole[name].title } };
  }
  if (whole.polar) whole.polar = { bgcolor: "rgba(0,0,0,0)", ...whole.polar };
  // What was said while nothing was drawn yet.
  for (const said of box.querySelectorAll(":scope > p, :scope > .problem")) said.remove();
  if (!box.isConnected) return;
  if (box.data && !box.querySelector(".plot-container")) {
    Plotly.purge(box); // a problem took the plot's place
    box.turned = null;
  }
  for (const other of drawn) {
    if (other.isConnected || other.drawing) continue;
    Plotly.purge(other); // a browser has a few WebGL contexts only
    drawn.delete(other);
  }
  box.again = () => draw(box, traces, layout, about);
  drawn.add(box);
  box.drawing = (box.drawing || 0) + 1;
  try {
    await Plotly.react(box, traces, whole, { responsive: true, displayModeBar: false, displaylogo: false });
  } finally {
    box.drawing--;
  }
  box.setAttribute("role", "img");
  box.setAttribute("aria-label", about);
  box.dataset.drawn = String(Number(box.dataset.drawn || 0) + 1);
}

/** Change a drawn plot's layout. */
export const relayout = async (box, changes) => (await plotly()).relayout(box, changes);

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const box of drawn) if (box.isConnected) box.again();
});

/** A colour bar with a scale's ticks. */
export const bar = (scaled, title) => ({
  title: { text: title, side: "right" }, thickness: 12, outlinewidth: 0, len: 0.95, tickvals: scaled.tickvals, ticktext: scaled.ticktext,
});

/** An axis with a scale's ticks. */
export const scaledAxis = (scaled, title) => ({
  title: { text: title }, tickvals: scaled.tickvals, ticktext: scaled.ticktext, range: [scaled.from - 0.03 * (scaled.to - scaled.from), scaled.to + 0.04 * (scaled.to - scaled.from)],
});

/** Channels as a colour: R, G and B, or null where there are none. */
export function rgb(channels) {
  const found = ["R", "G", "B"].map((name) => channels.indexOf(name));
  return found.includes(-1) ? null : found;
}

/** Which of a row's values a choice shows: one channel's, or their mean. */
export function chosen(channels, choice) {
  const k = channels.indexOf(choice);
  if (k >= 0) return (row) => row[k];
  return (row) => row.reduce((sum, v) => sum + v, 0) / row.length;
}

/** A scaled value as a share of the scale, 0 to 1. */
export const share = (scaled, v) => {
  const at = scaled.at(v);
  return at === null ? 0 : Math.min(1, Math.max(0, (at - scaled.from) / (scaled.to - scaled.from)));
};
