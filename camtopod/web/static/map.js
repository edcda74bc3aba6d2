// The network map: cameras as nodes, black edges overlap, grey edges are unseen paths; dashed while provisional.

import { fill, h, s } from "./dom.js";
import { drawEdge, openPicture, pick } from "./elements.js";
import { findNear, fitted, grow, isFitting } from "./fit.js";
import { Flow } from "./flow.js";
import { Labels, findSides } from "./labels.js";
import { go } from "./place.js";
import { Pulses } from "./pulses.js";
import { Sight } from "./sight.js";
import { edgeTip, nodeTip } from "./tips.js";
import { View } from "./view.js";
import { plural } from "./words.js";

const UNIT = 110; // pixels of the map a hop, at scale 1
const DOT_PIXELS = [2.6, 6];
const NEAR_SCALE = 0.8;
const MARGIN_PIXELS = 60; // so far from the edge is a camera that has the focus
const SHOT_RATIO = 16 / 9; // width by height of a picture that is not there yet
const SHOTS_MAX = 60; // pictures in sight; more take too much memory
const STEP_PIXELS = 5; // that a key moves a camera on a plan
const TURNED_RATIO = 1.2; // height by width of a screen from which a wide map is turned
const KEPT_RATIO = 1.25; // by which a map that is not moved must be able to grow to be shown anew
const SETTLING_MILLISECONDS = 3000; // in which pictures arrive, and the map is shown anew with each
const NAME_PIXELS = 22; // below and above a camera when all of it is shown
const NAME_SHARE = 0.25; // of the window's width: half of a name, beyond which it has no room when all of it is shown
const EDGE_PIXELS = 6; // the same beside it and its name
const PLAN_PIXELS = 8; // the same of a floor plan
const DIRECTIONS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class NetworkMap {
  nodes = new Map(); // id -> {id, x, y, camera, element}
  edges = new Map(); // "a b" -> {key, a, b, edge, width, element}
  #between = new Map(); // "a b" -> how many objects are between these cameras
  #frame = 0;
  #focused = null;
  #chosen = [];
  #ill = new Set(); // ids of those that need attention
  #gone = new Set(); // ids of those without grabber and events for long
  #found = null; // ids that match the search, or null
  #chosenEdges = [];
  #pointed = null; // the node or edge under the pointer
  #styles = new Map(); // properties of the style of all that is drawn
  width = 0; // of the screen, in pixels, as drawn last
  height = 0;
  pictures = new Map(); // camera -> address of its picture
  plan = null; // the floor plan beneath the map
  radius = 0; // of cameras that are circles, in pixels
  shot = 0; // side of a square as large as most pictures, in pixels; 0 while cameras are circles
  #map = null; // what is shown
  #circle = 0; // radius of cameras without picture, in units of the map
  #turned = false; // x and y are swapped
  #covers = []; // elements that lie on it
  #covered = []; // where, [left, top, right, bottom] in its pixels
  #fitting = false; // all of it is to be shown with the next frame
  #kept = 0; // as of `fit`
  #begun = 0; // when the first cameras came

  constructor(element) {
    this.svg = s("svg", {
      class: "map",
      role: "group",
      "aria-label": "Network map. Arrow keys go from camera to camera, Enter opens one, plus and minus zoom.",
    });
    this.world = s("g", {});
    this.edgeLayer = s("g", { class: "edges" });
    this.flowLayer = s("g", { class: "flow", "aria-hidden": "true" });
    this.nodeLayer = s("g", { class: "nodes" });
    this.liveLayer = s("g", { class: "flow", "aria-hidden": "true" });
    this.labelLayer = s("g", { class: "labels", "aria-hidden": "true" });
    this.world.append(this.edgeLayer, this.flowLayer, this.nodeLayer, this.liveLayer);
    this.svg.append(this.world, this.labelLayer);
    this.tip = h("div", { class: "tip", hidden: true });
    element.append(this.svg, this.tip);
    this.view = new View(
      this.svg,
      () => this.redraw(),
      (x, y) => this.#tap(x, y),
      (x, y) => this.#grab(x, y),
    );
    this.labels = new Labels(this.labelLayer);
    this.sight = new Sight(this.edgeLayer, this.nodeLayer);
    this.flow = new Flow(this.flowLayer, this.liveLayer, this);
    this.pulses = new Pulses(this.liveLayer, this);
    this.svg.addEventListener("pointermove", (event) => this.#hover(event));
    this.svg.addEventListener("pointerleave", () => this.#point(null));
    this.svg.addEventListener("keydown", (event) => this.#key(event));
    this.sizes = new ResizeObserver(() => {
      this.#findCovered();
      if (this.#map && !this.plan && this.#isTurned(this.#map) !== this.#turned) this.update(this.#map);
      this.#settle();
    });
    this.sizes.observe(this.svg);
  }

  // Elements that lie on the map: it keeps them free of names, and when all of it is shown of cameras.
  coveredBy(...elements) {
    this.#covers.push(...elements);
    for (const element of elements) this.sizes.observe(element);
  }

  #findCovered() {
    const own = this.svg.getBoundingClientRect();
    this.#covered = this.#covers
      .map((element) => element.getBoundingClientRect())
      .filter((box) => box.width && box.height)
      .map((box) => [box.left - own.left, box.top - own.top, box.right - own.left, box.bottom - own.top]);
  }

  // Show a map; what is the same object as before is left alone.
  update(map) {
    const fresh = this.nodes.size === 0;
    this.#map = map;
    this.version = map.version; // 0 before the first one
    const placed = this.plan?.places(Object.keys(map.cameras));
    const turned = this.#turned;
    this.#turned = !this.plan && this.#isTurned(map);
    const moved = placed || turned !== this.#turned;
    for (const [id, camera] of Object.entries(map.cameras)) {
      const held = this.nodes.get(id);
      const at = placed?.get(id) ?? (this.#turned ? [camera.y, camera.x] : [camera.x, camera.y]);
      if (moved || held?.camera !== camera) this.#place(id, camera, at, held);
    }
    if (this.plan && !this.plan.element.isConnected) {
      const { element, width, height } = this.plan;
      element.setAttribute("width", width * UNIT);
      element.setAttribute("height", height * UNIT);
      this.world.prepend(element);
    }
    this.traffic = Math.max(1, ...Object.values(map.edges).map((edge) => edge.transitions));
    for (const [key, edge] of Object.entries(map.edges)) this.#join(key, edge);
    for (const [held, kept] of [
      [this.nodes, map.cameras],
      [this.edges, map.edges],
    ])
      for (const [key, { element }] of held)
        if (!Object.hasOwn(kept, key)) {
          element.remove();
          held.delete(key);
        }
    if (this.#pointed && !this.nodes.has(this.#pointed.id) && !this.edges.has(this.#pointed.key)) this.#point(null);
    findSides(this);
    this.sight.use(this.nodes, this.edges);
    this.#circle = findNear([...this.nodes.values()], UNIT);
    if (this.#focused === null || !this.nodes.has(this.#focused)) this.#roam(this.nodes.keys().next().value ?? null);
    this.#mark();
    if (fresh) this.#begun = performance.now();
    this.#settle();
  }

  // All is shown as long as nobody has moved the map.
  #settle() {
    if (this.view.touched) this.redraw();
    else this.fit(performance.now() - this.#begun < SETTLING_MILLISECONDS ? 0 : KEPT_RATIO);
  }

  // Whether the map is turned, so that a wide one fills a high screen.
  #isTurned({ cameras }) {
    const { clientWidth, clientHeight } = this.svg;
    if (clientHeight < TURNED_RATIO * clientWidth) return false;
    const range = (values) => Math.max(...values) - Math.min(...values);
    const all = Object.values(cameras);
    return all.length > 1 && range(all.map(({ x }) => x)) > range(all.map(({ y }) => y));
  }

  // Fits the map into the free part of the window, with the next frame. It keeps its place if it fits there and could not
  // be `kept` times as large.
  fit(kept = 0) {
    this.#fitting = true;
    this.#kept = kept;
    this.redraw();
  }

  #fitNow(width, height) {
    const boxesAt = (scale) => this.#boxes(scale);
    const best = fitted(boxesAt, width, height, this.#covered);
    const { x, y, scale } = this.view;
    const isKept = best[2] < this.#kept * scale && isFitting(boxesAt(scale), [x, y], width, height, this.#covered);
    if (!isKept) this.view.put(...best);
  }

  // What all of it takes at a scale, [left, top, right, bottom] each, in pixels from the map's origin.
  #boxes(scale) {
    this.#grow(scale);
    const boxes = [...this.nodes.values()].map((node) => {
      const [half, tall] = this.halves(node);
      const name = Math.min(NAME_SHARE * this.width, this.labels.measure(node.id, "name").half);
      const [wide, high] = [Math.max(half, name) + EDGE_PIXELS, tall + NAME_PIXELS];
      return [node.x * scale - wide, node.y * scale - high, node.x * scale + wide, node.y * scale + high];
    });
    const [right, bottom] = this.plan ? [this.plan.width, this.plan.height].map((hops) => hops * UNIT * scale + PLAN_PIXELS) : [];
    return this.plan ? [[-PLAN_PIXELS, -PLAN_PIXELS, right, bottom], ...boxes] : boxes;
  }

  #grow(scale) {
    const pictured = [...this.nodes.values()].filter(({ id }) => this.pictures.has(id));
    Object.assign(this, grow(pictured, scale, this.#circle, UNIT, Boolean(this.plan)));
  }

  // Mark the cameras or the edge that are open beside the map.
  choose(...ids) {
    this.#chosen = ids;
    if (ids.length && this.view.touched && !this.#inSight(ids)) this.show(ids[0]); // else it is fitted to the window
    this.#mark();
    this.redraw();
  }

  // Mark the cameras whose id holds `text`; returns them, all if there is no text.
  search(text) {
    const wanted = text.trim().toLowerCase();
    this.#found = wanted ? [...this.nodes.keys()].filter((id) => id.toLowerCase().includes(wanted)) : null;
    this.#mark();
    this.redraw();
    return this.#found;
  }

  // Go to a camera on the map.
  show(id) {
    const node = this.nodes.get(id);
    if (node) this.view.centre(node.x, node.y, NEAR_SCALE);
  }

  focus(id) {
    if (!this.nodes.has(id)) return;
    this.#roam(id);
    this.sight.add(this.nodes.get(id));
    this.nodes.get(id).element.focus({ preventScroll: true });
  }

  // Mark who is not well, now and on maps to come.
  health(ill, gone) {
    const before = [this.#ill, this.#gone];
    [this.#ill, this.#gone] = [ill, gone];
    for (const node of this.nodes.values())
      if ([ill, gone].some((ids, k) => ids.has(node.id) !== before[k].has(node.id))) this.describe(node);
    this.redraw();
  }

  // Show how many objects are between cameras; pairs: as in the daemon's status.
  showBetween(pairs) {
    this.#between = new Map();
    for (const { from, to, number } of pairs) {
      const key = [from, to].sort().join(" ");
      this.#between.set(key, this.between(key) + number);
    }
    this.redraw();
  }

  between(key) {
    return this.#between.get(key) ?? 0;
  }

  // Say of a node what is seen of it.
  describe({ id, camera, element, entered, counts, when }) {
    const ill = this.#ill.has(id);
    const gone = this.#gone.has(id);
    element.classList.toggle("ill", ill);
    element.classList.toggle("gone", gone);
    const state = ill ? ", needs attention" : gone ? ", gone" : "";
    const learned = camera.new ? "new, no version yet" : plural(camera.zones, "zone");
    const name = `Camera ${id}, ${learned}${state}${entered.textContent && `, ${plural(counts[0], "entry", "entries")} ${when}`}`;
    if (element.getAttribute("aria-label") !== name) element.setAttribute("aria-label", name);
  }

  // Draw with the next frame.
  redraw() {
    this.#frame ||= requestAnimationFrame(() => {
      this.#frame = 0;
      const { clientWidth: width, clientHeight: height } = this.svg; // before anything is written, which is dear to ask after
      Object.assign(this, { width, height });
      if (this.#fitting && this.nodes.size && width) this.#fitNow(width, height);
      this.#fitting = false;
      const { x, y, scale } = this.view;
      this.world.setAttribute("transform", `translate(${x.toFixed(2)} ${y.toFixed(2)}) scale(${scale})`);
      const near = Math.min(1, scale / NEAR_SCALE);
      this.#grow(scale);
      const { radius } = this;
      this.#style("--radius", `${radius / scale}px`);
      this.#style("--pixel", `${1 / scale}px`);
      this.#style("--thin", Math.max(0.4, near).toFixed(2));
      this.#style("--dot", `${Math.min(DOT_PIXELS[1], Math.max(DOT_PIXELS[0], 0.55 * radius)) / scale}px`);
      this.#style("--ring", `${(0.25 * radius).toFixed(2)}px`);
      this.sight.draw(this, width, height, this.#marked());
      this.#showPictures();
      this.labels.draw(this, new Set(this.#chosen), new Set(this.#found), this.#covered);
    });
  }

  // A property of the style of all that is drawn, set only if it is another, as each of them is looked at then.
  #style(name, value) {
    if (this.#styles.get(name) === value) return;
    this.#styles.set(name, value);
    this.world.style.setProperty(name, value);
  }

  // Nodes and edges that are drawn wherever they are, the most important ones first.
  #marked() {
    const ids = [this.#focused, ...this.#chosen, ...(this.#found ?? []), ...this.#ill];
    return [this.#pointed, ...this.#chosenEdges, ...ids.map((id) => this.nodes.get(id))].filter(Boolean);
  }

  // Half the width and half the height of a camera as drawn, in pixels.
  halves({ id, span, ratio }) {
    if (!this.shot || !this.pictures.has(id)) return [this.radius, this.radius];
    return [(span / 2) * Math.sqrt(ratio), span / 2 / Math.sqrt(ratio)];
  }

  // Show the pictures of the cameras in sight, if they are large enough and few enough.
  #showPictures() {
    const inSight = [...this.nodes.values()].filter((node) => this.pictures.has(node.id) && this.#inSight([node.id]));
    if (inSight.length > SHOTS_MAX) this.shot = 0;
    this.svg.classList.toggle("with-shots", this.shot > 0);
    if (!this.shot) return;
    for (const node of inSight) {
      node.shot ??= openPicture(node, this.pictures.get(node.id), () => this.#settle());
      for (const [k, name] of ["--wide", "--high"].entries())
        node.element.style.setProperty(name, `${((2 * this.halves(node)[k]) / this.view.scale).toFixed(2)}px`);
    }
  }

  #place(id, camera, at, held) {
    const [x, y] = at.map((value) => value * UNIT);
    const node = held ?? {
      id,
      element: s("g", { class: "node", role: "button", tabindex: "-1", data: { id } }, s("circle", {}), s("title", {})),
      entered: s("text", { class: "today", "aria-hidden": "true" }),
    };
    Object.assign(node, { x, y, camera, ratio: node.ratio ?? SHOT_RATIO });
    node.element.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
    this.describe(node);
    if (held) return;
    this.nodes.set(id, node);
    node.element.append(node.entered);
    node.element.addEventListener("focus", () => this.#focusedNode(node));
  }

  #join(key, edge) {
    const [a, b] = key.split(" ").map((id) => this.nodes.get(id));
    const drawn = this.edges.get(key) ?? { key, element: s("line", { data: { key } }) };
    this.edges.set(key, drawn);
    Object.assign(drawn, { a, b, edge });
    drawEdge(drawn, Math.sqrt(edge.transitions / this.traffic));
  }

  #mark() {
    const chosen = new Set(this.#chosen);
    const found = this.#found && new Set(this.#found);
    this.svg.classList.toggle("searched", Boolean(found));
    for (const [id, { element }] of this.nodes) {
      element.classList.toggle("chosen", chosen.has(id));
      element.classList.toggle("faint", Boolean(found && !found.has(id)));
    }
    this.#chosenEdges = [];
    for (const drawn of this.edges.values()) {
      const { element, a, b } = drawn;
      const both = chosen.has(a.id) && chosen.has(b.id);
      const isChosen = both || (chosen.size === 1 && (chosen.has(a.id) || chosen.has(b.id)));
      if (isChosen) this.#chosenEdges.push(drawn);
      element.classList.toggle("chosen", isChosen);
      element.classList.toggle("faint", Boolean(found && !found.has(a.id) && !found.has(b.id)));
    }
  }

  #inSight(ids, margin = 0) {
    const { clientWidth: width, clientHeight: height } = this.svg;
    return ids.every((id) => {
      const node = this.nodes.get(id);
      const [x, y] = node ? this.view.toScreen(node.x, node.y) : [0, 0];
      return !node || !width || Math.min(x, y, width - x, height - y) > margin;
    });
  }

  #tap(x, y) {
    const hit = pick(this, x, y);
    if (hit?.node) go("camera", hit.node.id);
    else if (hit?.drawn) go("pair", hit.drawn.a.id, hit.drawn.b.id);
    else if (this.#chosen.length) go("map");
  }

  // While cameras are placed on a plan: what moves the one at (x, y).
  #grab(x, y) {
    const node = this.plan?.placing ? pick(this, x, y)?.node : null;
    return node && ((...at) => this.#move(node.id, this.view.fromScreen(...at)));
  }

  #move(id, at) {
    this.view.touched = true; // or all of it would be shown anew
    this.plan.move(id, at.map((value) => value / UNIT));
    this.update(this.#map);
  }

  #hover(event) {
    if (event.pointerType === "touch" || event.buttons) return;
    const [x, y] = this.view.local(event);
    this.#point(pick(this, x, y), x, y);
  }

  #point(hit, x, y) {
    this.svg.classList.toggle("over", Boolean(hit));
    this.#pointed?.element.classList.remove("pointed");
    this.#pointed = hit?.node ?? hit?.drawn ?? null;
    this.tip.hidden = !hit;
    if (!hit) return;
    this.#pointed.element.classList.add("pointed");
    this.sight.add(this.#pointed);
    fill(this.tip, hit.node ? nodeTip(hit.node) : edgeTip(hit.drawn));
    const left = Math.min(x + 16, this.svg.clientWidth - this.tip.offsetWidth - 8);
    this.tip.style.transform = `translate(${Math.max(8, left)}px, ${y + 18 + this.tip.offsetHeight > this.svg.clientHeight ? y - this.tip.offsetHeight - 12 : y + 18}px)`;
  }

  // Exactly one node can be reached by Tab; the arrows go on from there.
  #roam(id) {
    this.nodes.get(this.#focused)?.element.setAttribute("tabindex", "-1");
    this.#focused = id;
    this.nodes.get(id)?.element.setAttribute("tabindex", "0");
  }

  #focusedNode(node) {
    this.#roam(node.id);
    if (this.plan?.placing) return; // who holds it does not want it moved
    if (!this.#inSight([node.id], MARGIN_PIXELS)) this.show(node.id);
  }

  #key(event) {
    const node = this.nodes.get(this.#focused);
    if (event.ctrlKey || event.metaKey || event.altKey || !node) return;
    if (event.key in DIRECTIONS && event.shiftKey && this.plan?.placing)
      this.#move(node.id, [0, 1].map((k) => [node.x, node.y][k] + (STEP_PIXELS * DIRECTIONS[event.key][k]) / this.view.scale));
    else if (event.key in DIRECTIONS) this.focus(this.#nextTo(node, DIRECTIONS[event.key])?.id);
    else if (event.key === "Enter" || event.key === " ") go("camera", node.id);
    else if (event.key === "+" || event.key === "=") this.view.zoom(1.4);
    else if (event.key === "-") this.view.zoom(1 / 1.4);
    else if (event.key === "0") this.fit();
    else return;
    event.preventDefault();
  }

  // The nearest camera in a direction: what lies aside counts double.
  #nextTo(from, [dx, dy]) {
    let best = null;
    let least = Infinity;
    for (const node of this.nodes.values()) {
      const [x, y] = [node.x - from.x, node.y - from.y];
      const ahead = x * dx + y * dy;
      const aside = Math.abs(x * dy - y * dx);
      if (ahead > 1 && ahead > 0.4 * aside && ahead + 2 * aside < least) [best, least] = [node, ahead + 2 * aside];
    }
    return best;
  }
}
