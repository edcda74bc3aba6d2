// Which cameras and edges of a large map are drawn: those on the screen. Where they are too many to tell apart, they are
// paths, one for each look and square of the map, which are made once a version. A smaller map is drawn whole.

import { s } from "./dom.js";

const NODES_MAX = 1200; // that are elements of their own
const MARKED_MAX = 200; // that are drawn wherever they are
const AIR_PIXELS = 40; // around the screen
const WIDTH_STEP = 2; // by which widths of edges differ there, pixels
const SQUARE = 660; // of the map whose cameras or edges are one path

export class Sight {
  #drawn = new Set(); // nodes and edges whose elements are on the map

  constructor(edgeLayer, nodeLayer) {
    this.edgeLayer = edgeLayer;
    this.nodeLayer = nodeLayer;
    this.farEdges = s("g", {});
    this.rims = s("g", {});
    this.cores = s("g", {});
    this.nodes = []; // on the screen
    this.far = false; // they are too many
    this.large = false; // more cameras than that are on the map
  }

  // Take a map: its nodes and edges.
  use(nodes, edges) {
    this.large = nodes.size > NODES_MAX;
    const paths = new Map(); // layer, style and square of the map -> its path and the segments of that
    const add = (layer, look, { x, y }, segment) => {
      const key = `${look} ${Math.floor(x / SQUARE)} ${Math.floor(y / SQUARE)}`;
      if (!paths.has(key)) paths.set(key, { layer, look, segments: [] });
      paths.get(key).segments.push(segment);
    };
    if (this.large) {
      for (const { a, b, look, width } of edges.values())
        add(this.farEdges, `edge ${look} wide-${Math.ceil(width / WIDTH_STEP)}`, a, `M${a.x.toFixed()} ${a.y.toFixed()}L${b.x.toFixed()} ${b.y.toFixed()}`);
      for (const node of nodes.values())
        for (const [layer, look] of [[this.rims, "rim"], [this.cores, "core"]])
          add(layer, look, node, `M${node.x.toFixed(1)} ${node.y.toFixed(1)}h.01`);
    }
    for (const layer of [this.farEdges, this.rims, this.cores]) layer.replaceChildren();
    for (const { layer, look, segments } of paths.values()) layer.append(s("path", { class: `far ${look}`, d: segments.join("") }));
  }

  // Draw the nodes and edges on a screen of this size, and the first of `marked`, those that are chosen or in need.
  draw({ nodes, edges, view }, width, height, marked) {
    const [left, top] = view.fromScreen(-AIR_PIXELS, -AIR_PIXELS);
    const [right, bottom] = view.fromScreen(width + AIR_PIXELS, height + AIR_PIXELS);
    const inside = ({ x, y }) => x > left && x < right && y > top && y < bottom;
    const crosses = ({ a, b }) =>
      Math.max(a.x, b.x) > left && Math.min(a.x, b.x) < right && Math.max(a.y, b.y) > top && Math.min(a.y, b.y) < bottom;
    this.nodes = [...nodes.values()].filter(inside);
    this.far = this.nodes.length > NODES_MAX;
    const near = this.far ? [] : [...this.nodes, ...[...edges.values()].filter(crosses)];
    const all = this.large ? near : [...nodes.values(), ...edges.values()];
    const wanted = new Set([...all, ...marked.slice(0, MARKED_MAX)]);
    for (const one of this.#drawn) if (!wanted.has(one)) one.element.remove();
    for (const one of wanted) this.#append(one);
    this.#drawn = wanted;
    this.#show(this.farEdges, this.edgeLayer, this.far);
    this.#show(this.cores, this.nodeLayer, this.far);
    this.#show(this.rims, this.nodeLayer, this.far);
  }

  // Have a node or edge on the map at once.
  add(one) {
    this.#append(one);
    this.#drawn.add(one);
  }

  // Whether what happens at a node is drawn: on a large map only in sight.
  follows(node) {
    return !this.large || this.nodes.includes(node);
  }

  #append(one) {
    if (!one.element.isConnected) (one.a ? this.edgeLayer : this.nodeLayer).append(one.element);
  }

  #show(element, layer, shown) {
    if (!shown) element.remove();
    else if (!element.isConnected) layer.prepend(element);
  }
}
