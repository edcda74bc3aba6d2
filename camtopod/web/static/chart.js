// Axes and scales of the charts.

import { s } from "./dom.js";

// Round values across a range, about `wanted` of them.
export function ticks(low, high, wanted = 5) {
  const rough = (high - low) / wanted;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((one) => one >= rough);
  const result = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k += 1)
    result.push(k === 0 ? 0 : Number((k * step).toPrecision(6)));
  return result;
}

// From values to pixels.
export function scale(low, high, from, to) {
  const slope = (to - from) / (high - low || 1);
  return (value) => from + (value - low) * slope;
}

export function points(values) {
  return values.map(([x, y], k) => `${k ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
}

// A horizontal axis under a chart, with grid lines up to `top`.
export function axisX(x, values, y, top, text) {
  return s(
    "g",
    { class: "axis" },
    values.map((value) => [
      s("line", { class: "grid", x1: x(value), x2: x(value), y1: top, y2: y }),
      s("text", { x: x(value), y: y + 16, "text-anchor": "middle" }, text(value)),
    ]),
  );
}

export function axisY(y, values, left, right, text) {
  return s(
    "g",
    { class: "axis" },
    values.map((value) => [
      s("line", { class: "grid", x1: left, x2: right, y1: y(value), y2: y(value) }),
      s("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, text(value)),
    ]),
  );
}
