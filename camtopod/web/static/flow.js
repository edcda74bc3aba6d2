// Predictions under way: a dot leaves the camera and arrives when it is expected, the fainter the less likely.

import { s } from "./dom.js";

const UNDER_WAY_MAX = 120;
const SHARE_MIN = 0.1;
const AGE_MAX_SECONDS = 10; // of a prediction that comes late: its dot begins further on
const LINGER_SECONDS = 1.5;
const QUICK_SECONDS = 0.8; // of a way that takes no time, between overlapping views
const SEES_SECONDS = 4;
const calm = matchMedia("(prefers-reduced-motion: reduce)");

export class Flow {
  #dots = [];
  #frame = 0;

  constructor(layer, map) {
    this.layer = layer;
    this.map = map;
  }

  // Send the dots of a prediction on their way; `age` in seconds.
  send(prediction, age) {
    const from = this.map.nodes.get(prediction.camera);
    if (!from || document.hidden) return;
    from.element.classList.remove("left");
    void from.element.getBoundingClientRect(); // so that the ring's animation begins anew
    from.element.classList.add("left");
    for (const { camera } of prediction.now) this.#sees(this.map.nodes.get(camera));
    const started = performance.now() / 1000 - Math.min(AGE_MAX_SECONDS, Math.max(0, age));
    for (const next of prediction.next) {
      const to = this.map.nodes.get(next.camera);
      if (!to || to === from || next.probability < SHARE_MIN || this.#dots.length >= UNDER_WAY_MAX) continue;
      const element = s("circle", { class: "dot" });
      element.style.setProperty("--share", Math.sqrt(next.probability).toFixed(3));
      this.layer.append(element);
      this.#dots.push({
        element,
        from,
        to,
        started,
        takes: Math.max(QUICK_SECONDS, next.q50),
        until: Math.max(QUICK_SECONDS, next.q90),
      });
    }
    this.#frame ||= requestAnimationFrame(() => this.#step());
  }

  // Mark for a while a camera that sees somebody who has just left another view.
  #sees(node) {
    if (!node) return;
    node.element.classList.add("sees");
    clearTimeout(node.seeing);
    node.seeing = setTimeout(() => node.element.classList.remove("sees"), 1000 * SEES_SECONDS);
  }

  get underWay() {
    return this.#dots.length;
  }

  #step() {
    const now = performance.now() / 1000;
    this.#dots = this.#dots.filter((dot) => {
      const since = now - dot.started;
      const gone = since > dot.until + LINGER_SECONDS || !dot.to.element.isConnected;
      if (gone) {
        dot.element.remove();
        return false;
      }
      const along = calm.matches ? 0.5 : Math.min(1, since / dot.takes);
      dot.element.setAttribute("cx", (dot.from.x + along * (dot.to.x - dot.from.x)).toFixed(1));
      dot.element.setAttribute("cy", (dot.from.y + along * (dot.to.y - dot.from.y)).toFixed(1));
      dot.element.classList.toggle("late", since > dot.takes);
      return true;
    });
    this.#frame = this.#dots.length ? requestAnimationFrame(() => this.#step()) : 0;
  }
}
