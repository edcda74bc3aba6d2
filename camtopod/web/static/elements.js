// Nodes and edges of the network map: their look, and the one at a place.

import { s } from "./dom.js";
import { fromLine } from "./view.js";

const PICK_PIXELS = 14;
const WIDTH_PIXELS = [1.2, 7]; // of an edge, by traffic
const LIKELY_PIXELS = 2.2; // width of an edge that is not published

// Give an edge the width of its share of the traffic, from 0 to 1, and the look of its relation.
export function drawEdge(drawn, share) {
  const { a, b, edge, element } = drawn;
  const width = edge.published ? WIDTH_PIXELS[0] + (WIDTH_PIXELS[1] - WIDTH_PIXELS[0]) * share : LIKELY_PIXELS;
  const look = `${edge.relation}${!edge.published ? " likely" : edge.provisional ? " provisional" : ""}`;
  const drawing = [a.x, a.y, b.x, b.y, width, look].join(" ");
  if (drawn.drawing === drawing) return;
  Object.assign(drawn, { width, look, drawing });
  for (const [name, value] of Object.entries({ x1: a.x, y1: a.y, x2: b.x, y2: b.y }))
    element.setAttribute(name, value.toFixed(1));
  element.style.setProperty("--width", width.toFixed(2));
  element.setAttribute("class", `edge ${look}`);
}

// All of a camera's picture, as wide and as high as it is, in a frame, which is returned at once.
export function openPicture(node, address, onOpen) {
  const shot = s("rect", { class: "shot" });
  node.element.classList.add("pictured");
  node.entered.before(shot);
  const image = new Image();
  image.addEventListener("load", () => {
    node.ratio = image.naturalWidth / image.naturalHeight;
    shot.before(s("image", { href: image.src, preserveAspectRatio: "none" }));
    onOpen();
  });
  image.src = address;
  return shot;
}

// The node or edge of a map at a place on the screen, nodes first.
export function pick(map, px, py) {
  const { x, y, scale } = map.view;
  const [mx, my, near] = [(px - x) / scale, (py - y) / scale, PICK_PIXELS / scale];
  let best = null;
  let least = near;
  for (const node of map.nodes.values()) {
    const [wide, high] = map.halves(node);
    if (Math.abs(node.x - mx) * scale < wide && Math.abs(node.y - my) * scale < high) return { node };
    const apart = Math.hypot(node.x - mx, node.y - my);
    if (apart < least) [best, least] = [{ node }, apart];
  }
  if (best) return best;
  least = 0.7 * near;
  for (const drawn of map.edges.values()) {
    const apart = fromLine(mx, my, drawn.a, drawn.b);
    if (apart < least) [best, least] = [{ drawn }, apart];
  }
  return best;
}
