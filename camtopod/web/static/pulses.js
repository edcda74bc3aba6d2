// Entries and exits, each a pulse on its camera at the place in the picture where it was seen.

import { s } from "./dom.js";

const PULSES_MAX = 200; // at a time
const PULSE_MILLISECONDS = 1600; // as in app.css

export class Pulses {
  constructor(layer, map) {
    this.layer = layer;
    this.map = map;
  }

  show({ camera, kind, x, y }) {
    const node = this.map.nodes.get(camera);
    if (!node || document.hidden || !this.map.sight.follows(node) || this.layer.childElementCount >= PULSES_MAX) return;
    const [wide, high] = this.map.halves(node).map((half) => (2 * half) / this.map.view.scale);
    const element = s("circle", {
      class: `pulse ${kind}`,
      cx: (node.x + wide * ((x ?? 0.5) - 0.5)).toFixed(1),
      cy: (node.y + high * ((y ?? 0.5) - 0.5)).toFixed(1),
    });
    this.layer.append(element);
    setTimeout(() => element.remove(), PULSE_MILLISECONDS);
  }
}
