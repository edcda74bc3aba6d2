// How large the map is, and its cameras: as large as the window allows.

const NODE_SHARE = 0.14; // radius of a circle, of a hop
const CLOSE_SHARE = 0.35; // the same at most, of the way to the nearest
const NODE_PIXELS = [1.8, 18];
const SPAN_PIXELS = [36, 270]; // side of a square as large as a picture; below, the camera is a circle
const NEAR_HOPS = 3;
const NEAR_MAX = 8; // neighbours that bound a picture's size
const APART_PIXELS = [84, 46]; // beside and above a picture, to the next: room for names and times
const APART_SHARE = 0.72; // of the way to the next that pictures take where there is no such room
const PLAN_SHARE = 0.9; // of a hop, on a floor plan, most of which stays in sight
const COMMON_SHARE = 0.35; // of the cameras whose pictures are smaller than the others, as they lie closer together
const SCALES = [0.02, 4];
const HALVINGS = 14; // in search of the scale
const PLACES = Array.from({ length: 81 }, (_, k) => [k % 9, Math.floor(k / 9)].map((at) => at / 8)).sort(
  (one, other) => off(one) - off(other),
); // tried for the map: shares of the room that is left beside and above it, the middle first

// Tell each node its nearest ones; the radius of circles so that hardly any two touch; it and `hop` in units of the map.
export function findNear(nodes, hop) {
  const side = NEAR_HOPS * hop; // of the squares of a grid
  const squares = new Map();
  const square = (column, row) => squares.get(`${column} ${row}`) ?? [];
  const placeOf = ({ x, y }) => [Math.floor(x / side), Math.floor(y / side)];
  for (const node of nodes) squares.set(placeOf(node).join(" "), [...square(...placeOf(node)), node]);
  for (const node of nodes) {
    const apart = ({ x, y }) => Math.hypot(x - node.x, y - node.y);
    const [column, row] = placeOf(node);
    const around = [-1, 0, 1].flatMap((right) => [-1, 0, 1].flatMap((down) => square(column + right, row + down)));
    const others = around.filter((other) => other !== node && apart(other) < side);
    node.near = others.sort((one, other) => apart(one) - apart(other)).slice(0, NEAR_MAX);
    node.apart = node.near.length ? apart(node.near[0]) : Infinity;
  }
  const sorted = nodes.map((node) => node.apart).sort((one, other) => one - other);
  return Math.min(NODE_SHARE * hop, CLOSE_SHARE * Math.max(hop / 8, sorted[Math.floor(sorted.length / 10)] ?? Infinity));
}

// Sizes at a scale, in pixels: the radius of cameras that are circles, and for each of `pictured` the `span`, the side of
// a square as large as its picture: one for all but those whose neighbours are too close; shot: that one, or 0 for none.
export function grow(pictured, scale, circle, hop, planned) {
  const largest = Math.min(SPAN_PIXELS[1], planned ? PLAN_SHARE * hop * scale : Infinity);
  for (const node of pictured) node.span = Math.min(largest, ...node.near.map((other) => most(node, other, scale)));
  const spans = pictured.map(({ span }) => span).sort((one, other) => one - other);
  const common = spans[Math.floor(COMMON_SHARE * spans.length)] ?? 0;
  for (const node of pictured) node.span = Math.min(common, node.span);
  const radius = Math.min(NODE_PIXELS[1], Math.max(NODE_PIXELS[0], circle * scale));
  return { radius, shot: common >= SPAN_PIXELS[0] ? common : 0 };
}

// The span of two nodes' pictures so that there is room between them.
function most(one, other, scale) {
  const wide = (Math.sqrt(one.ratio) + Math.sqrt(other.ratio)) / 2;
  const high = (1 / Math.sqrt(one.ratio) + 1 / Math.sqrt(other.ratio)) / 2;
  const [dx, dy] = [Math.abs(one.x - other.x) * scale, Math.abs(one.y - other.y) * scale];
  const [aside, above] = APART_PIXELS;
  return Math.max((dx - aside) / wide, (dy - above) / high, APART_SHARE * Math.max(dx / wide, dy / high));
}

// Where the map's origin is and its largest scale, [x, y, scale], so that all of `boxesAt(scale)` is in sight and, if
// possible, nothing under one of `covers`; boxes are [left, top, right, bottom] in pixels.
export function fitted(boxesAt, width, height, covers) {
  for (const those of [covers, []]) {
    let [least, most] = SCALES;
    let best = null;
    for (let k = 0; k < HALVINGS; k += 1) {
      const scale = Math.sqrt(least * most);
      const place = placed(boxesAt(scale), width, height, those);
      if (place) [best, least] = [[...place, scale], scale];
      else most = scale;
    }
    if (best) return best;
  }
  return [width / 2, height / 2, SCALES[0]];
}

// The place nearest to the middle of the window where all boxes are in sight and none under one of `covers`, or null.
function placed(boxes, width, height, covers) {
  const [left, top] = [0, 1].map((k) => boxes.reduce((far, box) => Math.min(far, box[k]), Infinity));
  const [right, bottom] = [2, 3].map((k) => boxes.reduce((far, box) => Math.max(far, box[k]), -Infinity));
  const [beside, above] = [width - (right - left), height - (bottom - top)];
  if (beside < 0 || above < 0) return null;
  /** @type {(place: number[]) => boolean} */
  const free = (place) => isFree(boxes, place, covers);
  return PLACES.map(([along, down]) => [along * beside - left, down * above - top]).find(free) ?? null;
}

// True if no box of `boxes` is covered, with the map's origin at (x, y).
/** @param {number[][]} boxes @param {number[]} place @param {number[][]} covers */
function isFree(boxes, [x, y], covers) {
  return boxes.every((box) =>
    covers.every((one) => box[2] + x <= one[0] || box[0] + x >= one[2] || box[3] + y <= one[1] || box[1] + y >= one[3]),
  );
}

// True if all of `boxes` are visible and not covered, with the map's origin at (x, y).
/** @param {number[][]} boxes @param {number[]} place @param {number} width @param {number} height @param {number[][]} covers */
export function isFitting(boxes, [x, y], width, height, covers) {
  /** @type {(box: number[]) => boolean} */
  const isInside = (box) => box[0] + x >= 0 && box[1] + y >= 0 && box[2] + x <= width && box[3] + y <= height;
  return boxes.every(isInside) && isFree(boxes, [x, y], covers);
}

/** @param {number[]} place */
function off([along, down]) {
  return Math.hypot(along - 0.5, down - 0.5);
}
