// Tooltips of cameras and edges on the map.

import { h } from "./dom.js";
import { count, percent, plural, seconds, span, transit } from "./words.js";

// Tooltip of a camera.
export function nodeTip({ id, camera, counts, when }) {
  return [
    h("b", {}, id),
    h(
      "span",
      {},
      camera.new
        ? "new, no version yet"
        : `${plural(camera.zones, "zone")} · about ${count(camera.entries)} in, ${count(camera.exits)} out`,
    ),
    counts ? h("span", {}, `${when}: ${count(counts[0])} in, ${count(counts[1])} out`) : null,
  ];
}

// Tooltip of an edge.
export function edgeTip({ a, b, edge }) {
  const kind = edge.relation === "overlapped" ? "Overlapping views" : "Unseen path";
  return [
    h("b", {}, `${a.id} – ${b.id}`),
    h("span", {}, kind + (!edge.published ? ", likely" : edge.provisional ? ", provisional" : "")),
    edge.ways.map((way) =>
      h(
        "span",
        {},
        way.transit.mode < 0
          ? `${way.from} → ${way.to}: both views, appears ${transit(way.transit.mode)}, ${percent(way.probability)}`
          : `${way.from} → ${way.to}: ${seconds(way.transit.mode)} (${span(way.transit.q10, way.transit.q90)}), ${percent(way.probability)}`,
      ),
    ),
    edge.provisional ? h("span", { class: "note" }, edge.provisional) : null,
  ];
}
