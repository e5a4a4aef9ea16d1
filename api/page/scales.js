// Scales of values: linear, logarithmic and cube root, with their ticks. All plots place values through these.

export const SCALES = [["linear", "linear"], ["log", "logarithmic"], ["cbrt", "cube root"]];

/** A scale in words. */
export const inWords = (name) => SCALES.find(([one]) => one === name)?.[1] || name;

const PLACE = { linear: (v) => v, cbrt: Math.cbrt, log: Math.log10 };

/** Decades that a logarithmic scale goes below the largest value. */
const DECADES = 6;

/** The scale of that name for these values: where a value is (null where it can't be), and ticks. */
export function scale(name, values) {
  let low = Infinity, high = -Infinity;
  for (const v of values) {
    if (!Number.isFinite(v) || (name === "log" && v <= 0)) continue;
    if (v < low) low = v;
    if (v > high) high = v;
  }
  if (low > high) [low, high] = name === "log" ? [0.1, 1] : [0, 1];
  if (name === "log") {
    low = Math.max(low, high / 10 ** DECADES);
    // Some room below, or the least of a lobe would have no radius.
    low /= Math.max(high / low, 10) ** 0.15;
  } else low = Math.min(low, 0);
  if (high === low) high = low + (Math.abs(low) || 1);
  const place = PLACE[name];
  const at = (v) => (v === null || v === undefined || !Number.isFinite(v) || (name === "log" && v < low) ? null : place(v));
  const ticks = ticksOf(name, low, high);
  return { name, low, high, at, from: place(low), to: place(high), tickvals: ticks.map(place), ticktext: ticks.map(label) };
}

function ticksOf(name, low, high) {
  if (name === "linear") return linear(low, high);
  if (name === "log") {
    const powers = [];
    for (let p = Math.floor(Math.log10(low)); p <= Math.ceil(Math.log10(high)); p++) powers.push(p);
    const factors = powers.length <= 2 ? [1, 2, 5] : powers.length <= 4 ? [1, 3] : [1];
    return powers.flatMap((p) => factors.map((f) => f * 10 ** p)).filter((v) => v >= low * 0.999 && v <= high * 1.001);
  }
  // Round numbers, the largest first, each far enough from those taken.
  const apart = (Math.cbrt(high) - Math.cbrt(low)) / 9;
  const round = [];
  for (let p = Math.ceil(Math.log10(Math.max(high, -low))); p > -9; p--) for (const f of [5, 2, 1]) round.push(f * 10 ** p);
  const taken = [0];
  for (const v of round.flatMap((one) => [one, -one])) {
    if (v >= low && v <= high && taken.every((other) => Math.abs(Math.cbrt(other) - Math.cbrt(v)) >= apart)) taken.push(v);
  }
  return taken;
}

function linear(low, high) {
  const rough = (high - low) / 5;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((f) => f * power >= rough) * power;
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

function label(v) {
  if (v === 0) return "0";
  const size = Math.abs(v);
  if (size >= 1e4 || size < 1e-3) return v.toExponential(0).replace("e+", "e");
  return String(Number(v.toPrecision(3)));
}
