// Names and transit times on the map, as many as fit, none upon another: names of busy cameras first, then times, those
// of published and busy edges first; after a time, how many objects are between the two cameras.

import { s } from "./dom.js";
import { seconds } from "./words.js";

const NAMES_MAX = 160;
const NAMES_TRIED_MAX = 800; // of the busiest cameras in sight; more names have no room
const TIMES_MAX = 80;
const AIR_PIXELS = 3; // on either side of a text
const MEASURED_MAX = 10_000; // texts whose size is remembered
const EDGE_PIXELS_MIN = 40; // a time beside a shorter edge could be any edge's
const SEEN_PIXELS_MIN = 14; // so much of an edge stays in sight when its time lies on it
const ALONG = [1 / 2, 0.4, 0.6, 1 / 3, 2 / 3]; // where on an edge its time may stand
const OTHER_PIXELS = 5; // so far it keeps from other edges
const CELL = 64;
const ARROWS = ["→", "↘", "↓", "↙", "←", "↖", "↑", "↗"]; // by eighths of a turn, y downwards

// Below, above, right, left of a node: where its name may stand.
const SIDES = [
  [0, 1],
  [0, -1],
  [1, 0],
  [-1, 0],
];

export class Labels {
  #pool = [];
  #measured = new Map(); // class and text -> its size
  #pens = new Map(); // class -> a canvas with its font, which measures without a layout of the page

  constructor(layer) {
    this.layer = layer;
  }

  // Draw those in sight: the cameras in `chosen` whatever happens, then those in `found`, then all others; nothing
  // under the boxes `covers`, [left, top, right, bottom] each.
  draw(map, chosen, found, covers) {
    const taken = new Taken();
    for (const box of covers) taken.add(...box);
    const measure = (text, kind) => this.measure(text, kind);
    const names = placeNames(map, chosen, found, taken, measure);
    const times = placeTimes(map, chosen, taken, measure);
    this.#show([...names, ...times]);
  }

  // Half the width of a text with air, its height, and the height above its baseline, in pixels, as this browser
  // draws it: fonts differ.
  measure(text, kind) {
    const key = `${kind} ${text}`;
    if (this.#measured.has(key)) return this.#measured.get(key);
    if (!this.#pens.has(kind)) this.#pens.set(kind, this.#pen(kind));
    const { width, fontBoundingBoxAscent: above, fontBoundingBoxDescent: below } = this.#pens.get(kind).measureText(text);
    const size = { half: width / 2 + AIR_PIXELS, height: above + below, above };
    if (this.#measured.size >= MEASURED_MAX) this.#measured.clear();
    this.#measured.set(key, size);
    return size;
  }

  #pen(kind) {
    const probe = s("text", { class: kind });
    this.layer.append(probe);
    const pen = document.createElement("canvas").getContext("2d");
    const { fontWeight, fontSize, fontFamily } = getComputedStyle(probe);
    pen.font = `${fontWeight} ${fontSize} ${fontFamily}`;
    probe.remove();
    return pen;
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

// Tell each node on which side its name has most room.
export function findSides({ nodes, edges }) {
  const towards = new Map([...nodes.keys()].map((id) => [id, []]));
  for (const { a, b } of edges.values()) {
    const length = Math.hypot(b.x - a.x, b.y - a.y) || 1;
    const [dx, dy] = [(b.x - a.x) / length, (b.y - a.y) / length];
    towards.get(a.id).push([dx, dy]);
    towards.get(b.id).push([-dx, -dy]);
  }
  for (const [id, node] of nodes) {
    /** @type {(side: number[]) => number} */
    const crowd = ([x, y]) => Math.max(0, ...towards.get(id).map(([dx, dy]) => dx * x + dy * y));
    node.side = SIDES.reduce((best, side) => (crowd(side) < crowd(best) - 0.15 ? side : best));
  }
}

function placeNames(map, chosen, found, taken, measure) {
  const { width, height } = map;
  const wanted = [];
  const inSight = [];
  for (const node of map.sight.nodes) {
    const [x, y] = map.view.toScreen(node.x, node.y);
    const { entries, exits } = node.camera;
    inSight.push({ node, x, y, rank: (chosen.has(node.id) ? 1e13 : found.has(node.id) ? 1e12 : 0) + entries + exits });
    const [wide, high] = map.halves(node);
    taken.add(x - wide, y - high, x + wide, y + high);
  }
  inSight.sort((one, other) => other.rank - one.rank);
  for (const { node, x, y } of inSight.slice(0, NAMES_TRIED_MAX)) {
    if (wanted.length >= NAMES_MAX) break;
    const kind = chosen.has(node.id) || found.has(node.id) ? "name first" : "name";
    const text = node.camera.new && map.version ? `${node.id} (new)` : node.id;
    const { half, height: tall, above } = measure(text, kind);
    const [wide, high] = map.halves(node);
    const places = [node.side, ...SIDES].map(([dx, dy]) => {
      const [mx, my] = [x + dx * (wide + half + 2), y + dy * (high + tall / 2 + 3)];
      return [mx - half, my - tall / 2, mx + half, my + tall / 2];
    });
    /** @type {(box: number[]) => boolean} */
    const inside = ([left, top, right, bottom]) => left >= 0 && top >= 0 && right <= width && bottom <= height;
    const box = places.find((one) => inside(one) && taken.free(...one)) ?? (chosen.has(node.id) ? places[0] : null);
    if (!box) continue;
    taken.add(...box);
    wanted.push({ text, x: box[0] + half, y: box[1] + above, kind });
  }
  return wanted;
}

function placeTimes(map, chosen, taken, measure) {
  const { width, height } = map;
  const lines = [];
  for (const { key, a, b, edge, width: thick } of map.edges.values()) {
    const [ax, ay] = map.view.toScreen(a.x, a.y);
    const [bx, by] = map.view.toScreen(b.x, b.y);
    if (Math.max(ax, bx) < 0 || Math.max(ay, by) < 0 || Math.min(ax, bx) > width || Math.min(ay, by) > height) continue;
    lines.push({ key, a, b, edge, ax, ay, dx: bx - ax, dy: by - ay, length: Math.hypot(bx - ax, by - ay), thick });
  }
  const rank = ({ a, b, edge }) =>
    (chosen.has(a.id) && chosen.has(b.id) ? 2e12 : 0) + (edge.provisional ? 0 : 1e12) + edge.transitions;
  const long = lines.filter(({ length, edge }) => length >= EDGE_PIXELS_MIN && edge.ways.length && edge.published);
  long.sort((one, other) => rank(other) - rank(one));
  const settled = lines.filter((line) => !line.edge.provisional);
  const wanted = [];
  for (const line of long) {
    if (wanted.length >= TIMES_MAX) break;
    const number = Math.round(map.between(line.key));
    const text = number ? `${edgeText(line)} · ${number}` : edgeText(line);
    const kind = `time ${line.edge.relation}`;
    const { half, height: tall, above } = measure(text, kind);
    const [on, beside, further] = placesOf(line, half, tall, map);
    const boxAt = ([x, y]) => [x - half, y - tall / 2, x + half, y + tall / 2];
    /** @type {(box: number[]) => boolean} */
    const inside = ([left, top, right, bottom]) => left > 0 && top > 0 && right < width && bottom < height;
    const free = (place) => inside(boxAt(place)) && taken.free(...boxAt(place));
    const clearOf = (others) => (place) =>
      others.every((one) => one === line || apart(one, place, half, tall) > OTHER_PIXELS);
    const tried = line.edge.provisional
      ? [[[...on, ...beside], lines]]
      : [
          [on, lines],
          [on, settled],
          [[...beside, ...further], lines],
          [on, []],
        ];
    const place = tried.map(([places, others]) => places.filter(free).find(clearOf(others))).find(Boolean);
    if (!place) continue;
    taken.add(...boxAt(place));
    wanted.push({ text, x: place[0], y: place[1] - tall / 2 + above, kind });
  }
  return wanted;
}

// Where the time of an edge may stand: upon it, as long as enough of it stays in sight, beside it, and further beside.
function placesOf({ a, b, ax, ay, dx, dy, length, thick }, half, tall, map) {
  const [ux, uy] = [dx / length, dy / length];
  const hidden = 2 * Math.min(half / Math.abs(ux), tall / 2 / Math.abs(uy));
  const under = [a, b].map((node) => hiddenBy(node, ux, uy, map));
  const on = length - under[0] - under[1] - hidden >= SEEN_PIXELS_MIN ? ALONG : [];
  const aside = Math.abs(uy) * half + Math.abs(ux) * (tall / 2) + thick / 2 + 2;
  return [
    on.map((share) => [ax + share * dx, ay + share * dy]),
    ...[aside, aside + map.radius].map((off) =>
      [-off, off].map((one) => [ax + dx / 2 - one * uy, ay + dy / 2 + one * ux]),
    ),
  ];
}

// How many pixels of an edge in the direction (ux, uy) a camera covers.
function hiddenBy(node, ux, uy, map) {
  const [wide, high] = map.halves(node);
  return Math.min(wide / Math.abs(ux), high / Math.abs(uy));
}

// Pixels between an edge and a time of half the width `half` and the height `tall` at a place.
function apart({ ax, ay, dx, dy }, [x, y], half, tall) {
  return Math.min(
    ...[-half, 0, half].map((shift) => {
      const [px, py] = [x + shift - ax, y - ay];
      const along = Math.min(1, Math.max(0, (px * dx + py * dy) / (dx * dx + dy * dy || 1)));
      return Math.hypot(px - along * dx, py - along * dy) - tall / 2;
    }),
  );
}

// The transit time of an edge, "overlap" if objects appear before they leave; one where both ways are about the same; else each with an arrow the way it is of, as the
// edge lies on the screen.
function edgeText({ a, edge, dx, dy }) {
  const [one, other] = edge.ways;
  const modes = edge.ways.map((way) => way.transit.mode);
  if (modes.some((mode) => mode < 0)) return "overlap";
  const [first, second] = modes.map((mode) => seconds(mode));
  if (!other || Math.abs(modes[0] - modes[1]) <= 0.15 * Math.max(...modes)) return first;
  const eighth = Math.round(Math.atan2(dy, dx) / (Math.PI / 4)) + 8;
  const arrow = (way) => ARROWS[(eighth + (way.from === a.id ? 0 : 4)) % 8];
  const short = first.endsWith(" s") && second.endsWith(" s") ? first.slice(0, -2) : first;
  return `${arrow(one)} ${short} ${arrow(other)} ${second}`;
}

// Which parts of the screen are taken, in a coarse grid so that a thousand are quickly asked.
export class Taken {
  #cells = new Map();

  /** @param {number[]} box */
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

  /** @param {number[]} box */
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
