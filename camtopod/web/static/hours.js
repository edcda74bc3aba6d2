// Entries and exits of each camera by the hour: of today, and of a day as small bars.

import { h, s } from "./dom.js";
import { clock, count, plural } from "./words.js";

const WIDTH = 420;
const HEIGHT = 64;
const BOTTOM = 16; // for the hours
const SHOWN = 24;
const STEP = 6; // hours between two that are named
const HOUR = 3600;
const DIGIT_PIXELS = [7, 8]; // width of a digit of today's count, and half its height

// What the daemon has counted, and what has been seen since it was asked.
export class Hours {
  #counts = null; // {since, first, cameras: {id: [[entries, exits] of each hour]}}

  // Returns whether there was nothing before.
  use(counts) {
    const first = counts && !this.#counts;
    this.#counts = counts;
    if (counts) Object.setPrototypeOf(counts.cameras, null); // a camera may be named like what objects inherit
    return first;
  }

  add({ camera, kind, t }) {
    const hour = this.#counts ? Math.floor((t - this.#counts.first) / HOUR) : -1;
    if (hour < 0 || hour > 2 * SHOWN) return;
    const counts = (this.#counts.cameras[camera] ??= []);
    while (counts.length <= hour) counts.push([0, 0]);
    counts[hour][kind === "exit" ? 1 : 0] += 1;
  }

  // Entries and exits of a camera since the midnight before `now`, or null.
  today(id, now) {
    if (!this.#counts) return null;
    const midnight = new Date(1000 * now).setHours(0, 0, 0, 0) / 1000;
    const skipped = Math.max(0, Math.ceil((midnight - this.#counts.first) / HOUR));
    const counts = (this.#counts.cameras[id] ?? []).slice(skipped);
    return counts.reduce(([entries, exits], [more, less]) => [entries + more, exits + less], [0, 0]);
  }

  // What the chart of a camera needs, or null.
  of(id, now) {
    if (!this.#counts) return null;
    const { since, first, cameras } = this.#counts;
    const hours = Math.max(1, 1 + Math.floor((now - first) / HOUR));
    const counts = Array.from({ length: hours }, (_, k) => (cameras[id]?.[k] ?? [0, 0]).reduce((a, b) => a + b));
    return { since, first, counts };
  }
}

// Shows the entries of each camera on the map, if there is room. countsOf(id): entries and exits, or null; `when`: the
// time that they are of, in words.
export function writeCounts(map, countsOf, when) {
  for (const node of map.nodes.values()) {
    const [wide, high] = map.halves(node);
    const isSame = node.when === when;
    node.counts = countsOf(node.id);
    node.when = when;
    const text = node.counts && high > DIGIT_PIXELS[1] ? count(node.counts[0]) : "";
    const [full] = [`${text} in`, text, ""].filter((one) => one.length * DIGIT_PIXELS[0] < 2 * wide);
    const shown = text && full;
    if (isSame && node.entered.textContent === shown) continue;
    node.entered.textContent = shown;
    map.describe(node);
  }
}

// `first`: when the first hour begins; `counts`: events in each hour, the last one not over yet.
export function hourChart({ since, first, counts }) {
  const from = Math.max(0, counts.length - SHOWN);
  const shown = counts.slice(from);
  const top = Math.max(1, ...shown);
  const wide = WIDTH / SHOWN;
  const left = (k) => WIDTH - (shown.length - k) * wide;
  const hour = (k) => new Date(1000 * (first + 3600 * (from + k)));
  const high = (n) => ((HEIGHT - BOTTOM) * n) / top;
  const named = (k) => hour(k).getHours() % STEP === 0 || shown.length === 1;
  const isLive = since < first + HOUR * counts.length;
  const all = shown.reduce((sum, n) => sum + n, 0);
  return h(
    "figure",
    { class: "chart hours" },
    s(
      "svg",
      { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${plural(all, "event")}, at most ${count(top)} an hour` },
      s("line", { class: "grid", x1: 0, x2: WIDTH, y1: HEIGHT - BOTTOM, y2: HEIGHT - BOTTOM }),
      shown.map((n, k) =>
        s(
          "rect",
          { class: "count", x: left(k) + 1, width: wide - 2, y: HEIGHT - BOTTOM - high(n), height: high(n) },
          s("title", {}, `from ${String(hour(k).getHours()).padStart(2, "0")}:00: ${plural(n, "event")}`),
        ),
      ),
      shown.map((_, k) =>
        named(k)
          ? s("text", { x: Math.min(WIDTH - 16, left(k) + wide / 2), y: HEIGHT - 3, "text-anchor": "middle" }, `${hour(k).getHours()} h`)
          : null,
      ),
    ),
    h("figcaption", {}, `at most ${count(top)} an hour${isLive ? `; counted since ${clock(since)}` : ""}`),
  );
}
