// Names and transit times on the map, as many as fit: those of busy cameras first, none upon another.

import { s } from "./dom.js";
import { seconds } from "./words.js";

const NAMES_MAX = 160;
const TIMES_MAX = 80;
const CHARACTER_PIXELS = 8.5;
const LINE_PIXELS = 15;
const EDGE_PIXELS_MIN = 84; // a shorter edge has no room for its time
const CELL = 64;

// Below, above, right, left of a node: where its name may stand.
export const SIDES = [
  [0, 1],
  [0, -1],
  [1, 0],
  [-1, 0],
];

export class Labels {
  #pool = [];

  constructor(layer) {
    this.layer = layer;
  }

  // Draw those in sight: the cameras in `chosen` whatever happens, then those in `found`, then all others.
  draw(map, radius, chosen, found) {
    const { clientWidth: width, clientHeight: height } = map.svg;
    const taken = new Taken();
    const wanted = [];
    const inSight = [];
    for (const node of map.nodes.values()) {
      const [x, y] = map.view.toScreen(node.x, node.y);
      if (x < -40 || y < -20 || x > width + 40 || y > height + 20) continue;
      inSight.push({ node, x, y });
      taken.add(x - radius, y - radius, x + radius, y + radius);
    }
    const rank = ({ node }) =>
      (chosen.has(node.id) ? 1e13 : found.has(node.id) ? 1e12 : 0) + node.camera.entries + node.camera.exits;
    inSight.sort((one, other) => rank(other) - rank(one));
    for (const { node, x, y } of inSight) {
      if (wanted.length >= NAMES_MAX) break;
      const half = (CHARACTER_PIXELS * node.id.length) / 2;
      const places = [node.side, ...SIDES].map(([dx, dy]) => {
        const [mx, my] = [x + dx * (radius + half + 5), y + dy * (radius + LINE_PIXELS / 2 + 3)];
        return [mx - half, my - LINE_PIXELS / 2, mx + half, my + LINE_PIXELS / 2];
      });
      const inside = ([left, top, right, bottom]) => left >= 0 && top >= 0 && right <= width && bottom <= height;
      const box = places.find((one) => inside(one) && taken.free(...one)) ?? (chosen.has(node.id) ? places[0] : null);
      if (!box) continue;
      taken.add(...box);
      wanted.push({
        text: node.id,
        x: box[0] + half,
        y: box[1] + LINE_PIXELS / 2 + 4,
        kind: chosen.has(node.id) || found.has(node.id) ? "name first" : "name",
      });
    }
    let times = 0;
    for (const { a, b, edge } of map.edges.values()) {
      if (times >= TIMES_MAX) break;
      const [ax, ay] = map.view.toScreen(a.x, a.y);
      const [bx, by] = map.view.toScreen(b.x, b.y);
      const [x, y] = [(ax + bx) / 2, (ay + by) / 2];
      if (x < 0 || y < 0 || x > width || y > height || Math.hypot(ax - bx, ay - by) < EDGE_PIXELS_MIN) continue;
      const text = edgeText(edge);
      const half = (CHARACTER_PIXELS * text.length) / 2;
      if (!taken.free(x - half, y - 8, x + half, y + 8)) continue;
      taken.add(x - half, y - 8, x + half, y + 8);
      wanted.push({ text, x, y: y + 4, kind: `time ${edge.relation}` });
      times += 1;
    }
    this.#show(wanted);
  }

  #show(wanted) {
    while (this.#pool.length < wanted.length) {
      const element = s("text", { "text-anchor": "middle" });
      this.#pool.push(element);
      this.layer.append(element);
    }
    for (const element of this.#pool.splice(wanted.length)) element.remove();
    for (const [k, { text, x, y, kind }] of wanted.entries()) {
      const element = this.#pool[k];
      if (element.textContent !== text) element.textContent = text;
      element.setAttribute("class", kind);
      element.setAttribute("x", x.toFixed(1));
      element.setAttribute("y", y.toFixed(1));
    }
  }
}

// The transit time of an edge, one where both ways are about the same.
export function edgeText(edge) {
  const [one, other] = edge.ways.map((way) => way.mode);
  if (one === undefined) return "";
  if (other === undefined || Math.abs(one - other) <= 0.15 * Math.max(Math.abs(one), Math.abs(other)))
    return seconds(one);
  return `${seconds(one).replace(/ s$/, "")} / ${seconds(other)}`;
}

// Which parts of the screen are taken, in a coarse grid so that a thousand are quickly asked.
class Taken {
  #cells = new Map();

  add(...box) {
    for (const cell of this.#covered(box)) cell.push(box);
  }

  free(...box) {
    return this.#covered(box).every((cell) =>
      cell.every(
        ([left, top, right, bottom]) => box[2] <= left || box[0] >= right || box[3] <= top || box[1] >= bottom,
      ),
    );
  }

  #covered([left, top, right, bottom]) {
    const cells = [];
    for (let column = Math.floor(left / CELL); column <= Math.floor(right / CELL); column += 1) {
      for (let row = Math.floor(top / CELL); row <= Math.floor(bottom / CELL); row += 1) {
        const key = column * 100_003 + row;
        if (!this.#cells.has(key)) this.#cells.set(key, []);
        cells.push(this.#cells.get(key));
      }
    }
    return cells;
  }
}
