// What is under way on the map: predictions, whose dots leave a camera and arrive when they are expected, the fainter
// the less likely; and walks, whose dots go from camera to camera as entries are matched.

import { s } from "./dom.js";

const UNDER_WAY_MAX = 120;
const SHARE_MIN = 0.1;
const AGE_MAX_SECONDS = 10; // of a prediction that comes late: its dot begins further on
const LINGER_SECONDS = 1.5;
const QUICK_SECONDS = 0.8; // of a way that takes no time, between overlapping views
const WALK_SECONDS = 1.2; // of a walk's dot, from the camera before
const WALK_LINGER_SECONDS = 20; // at the camera where it is
const SEES_SECONDS = 4;
const calm = matchMedia("(prefers-reduced-motion: reduce)");

export class Flow {
  #dots = [];
  #frame = 0;

  // Dots of predictions go below the cameras, those of walks above.
  constructor(below, above, map) {
    this.below = below;
    this.above = above;
    this.map = map;
  }

  // Send the dots of a prediction on their way; `age` in seconds.
  send(prediction, age) {
    const from = this.map.nodes.get(prediction.camera);
    if (!from || document.hidden) return;
    for (const { camera } of prediction.now) this.#sees(this.map.nodes.get(camera));
    const started = performance.now() / 1000 - Math.min(AGE_MAX_SECONDS, Math.max(0, age));
    for (const next of prediction.next) {
      if (next.camera === prediction.camera || next.probability < SHARE_MIN || next.prior) continue; // a dot has a time
      const takes = Math.max(QUICK_SECONDS, next.q50);
      const until = Math.max(QUICK_SECONDS, next.q90) + LINGER_SECONDS;
      const dot = this.#begin(this.below, "dot", prediction.camera, next.camera, { started, takes, until, t: prediction.t });
      dot?.element.style.setProperty("--share", Math.sqrt(next.probability).toFixed(3));
    }
  }

  // An entry continues a walk: its dot comes from the camera before, or from where the prediction's dot is, and waits.
  walk({ camera, t, walk, from: [before] }) {
    if (this.#dots.some((dot) => dot.walk === walk && dot.t === t)) return; // only its probability is another
    const guesses = this.#dots.filter((dot) => dot.from.id === before.camera && dot.t === before.t);
    const right = guesses.find((dot) => dot.to.id === camera);
    const along = right ? Math.min(1, (performance.now() / 1000 - right.started) / right.takes) : 0;
    this.#drop((dot) => dot.walk === walk || guesses.includes(dot));
    const started = performance.now() / 1000 - along * WALK_SECONDS;
    const until = WALK_SECONDS + WALK_LINGER_SECONDS;
    this.#begin(this.above, "dot walk", before.camera, camera, { started, takes: WALK_SECONDS, until, t, walk });
  }

  // A step of a walk of before, in `takes` seconds.
  go(from, to, takes) {
    const started = performance.now() / 1000;
    this.#begin(this.above, "dot walk", from, to, { started, takes, until: takes });
  }

  clear() {
    this.#drop(() => true);
  }

  #begin(layer, look, from, to, more) {
    const [a, b] = [this.map.nodes.get(from), this.map.nodes.get(to)];
    if (!a || !b || a === b || document.hidden || this.#dots.length >= UNDER_WAY_MAX) return null;
    if (!this.map.sight.follows(a) && !this.map.sight.follows(b)) return null;
    const dot = { element: s("circle", { class: look }), from: a, to: b, ...more };
    layer.append(dot.element);
    this.#dots.push(dot);
    this.#frame ||= requestAnimationFrame(() => this.#step());
    return dot;
  }

  #drop(which) {
    for (const dot of this.#dots) if (which(dot)) dot.element.remove();
    this.#dots = this.#dots.filter((dot) => !which(dot));
  }

  // Mark for a while a camera that sees somebody who has just left another view.
  #sees(node) {
    if (!node) return;
    node.element.classList.add("sees");
    clearTimeout(node.seeing);
    node.seeing = setTimeout(() => node.element.classList.remove("sees"), 1000 * SEES_SECONDS);
  }

  #step() {
    const now = performance.now() / 1000;
    this.#drop((dot) => now - dot.started > dot.until || this.map.nodes.get(dot.to.id) !== dot.to);
    for (const dot of this.#dots) {
      const since = now - dot.started;
      const top = (node) => node.y - (dot.walk ? this.map.halves(node)[1] / this.map.view.scale : 0); // beside its count
      const along = calm.matches ? (dot.walk ? 1 : 0.5) : Math.min(1, since / dot.takes);
      dot.element.setAttribute("cx", (dot.from.x + along * (dot.to.x - dot.from.x)).toFixed(1));
      dot.element.setAttribute("cy", (top(dot.from) + along * (top(dot.to) - top(dot.from))).toFixed(1));
      dot.element.classList.toggle("late", since > dot.takes);
    }
    this.#frame = this.#dots.length ? requestAnimationFrame(() => this.#step()) : 0;
  }
}
