// Recent walks, newest first: entries that are of one object by their times. Each leads to its way on the map.

import { fill, h } from "./dom.js";
import { go, link } from "./place.js";
import { clock, percent } from "./words.js";

const WALKS_MAX = 300; // remembered
const SHOWN = 6;
const STEPS_SHOWN = 4; // the newest of a walk
const LIST_MILLISECONDS = 700; // no list is read that changes faster

export class Walks {
  #walks = new Map(); // name -> {steps: [{camera, t, probability}]}, the one heard of last at the end
  #of = new Map(); // entry -> name of its walk
  marked = null; // the walk that is shown on the map
  #timer = null;

  // pictureOf(id): address of a camera's picture, if there is one.
  constructor(pictureOf) {
    this.pictureOf = pictureOf;
    this.list = h("ul", {});
    this.element = h(
      "details",
      { class: "overlay walks", name: "news", hidden: true },
      h("summary", {}, "Walks"),
      this.list,
    );
  }

  // An entry with the passages that it may continue; it comes again if later events have changed that. Whether it
  // continues a walk.
  add({ camera, t, walk, from }) {
    const entry = `${camera} ${t}`;
    const old = this.#walks.get(this.#of.get(entry));
    if (old) old.steps = old.steps.filter((step) => step.camera !== camera || step.t !== t);
    const at = walk.lastIndexOf("@");
    const first = { camera: walk.slice(0, at), t: Number(walk.slice(at + 1)), probability: 1 };
    const continues = first.camera !== camera || Math.abs(first.t - t) > 0.001;
    const steps = this.#walks.get(walk)?.steps ?? (continues ? this.#renamed(first, walk) : null) ?? [first];
    if (continues && from.length) steps.push({ camera, t, probability: from[0].probability });
    steps.sort((one, other) => one.t - other.t);
    this.#walks.delete(walk);
    this.#walks.set(walk, { steps });
    this.#of.set(entry, walk);
    if (this.#walks.size > WALKS_MAX) this.#walks.delete(this.#walks.keys().next().value);
    if (this.#of.size > 10 * WALKS_MAX) this.#of.delete(this.#of.keys().next().value);
    this.#timer ??= setTimeout(() => this.#draw(), LIST_MILLISECONDS);
    return continues && from.length > 0;
  }

  // The steps of a walk by its name until now: it is named by its oldest passage of the last hour.
  #renamed(first, walk) {
    const before = this.#of.get(`${first.camera} ${first.t}`);
    const old = this.#walks.get(before);
    if (!old) return null;
    this.#walks.delete(before);
    const steps = old.steps.filter((step) => step.t >= first.t);
    for (const step of steps) this.#of.set(`${step.camera} ${step.t}`, walk);
    return steps;
  }

  // Forget the walks through any of the cameras, the keys of `names`.
  forget(names) {
    for (const [name, { steps }] of this.#walks) {
      if (!steps.some((step) => Object.hasOwn(names, step.camera))) continue;
      this.#walks.delete(name);
      if (name === this.marked) go("map");
      this.#timer ??= setTimeout(() => this.#draw(), LIST_MILLISECONDS);
    }
  }

  // Mark a walk in the list, or none; its cameras.
  mark(name) {
    this.marked = name;
    this.#draw();
    return (this.#walks.get(name)?.steps ?? []).map((step) => step.camera);
  }

  #draw() {
    clearTimeout(this.#timer);
    this.#timer = null;
    const all = [...this.#walks].filter(([, { steps }]) => steps.length > 1).reverse();
    const shown = all.filter(([name], k) => k < SHOWN || name === this.marked);
    this.element.hidden = !shown.length;
    fill(this.list, shown.map(([name, { steps }]) => h("li", {}, this.#walk(name, steps))));
  }

  #picture(camera) {
    const address = this.pictureOf(camera);
    return address ? h("img", { src: address, alt: "" }) : null;
  }

  #walk(name, steps) {
    const shown = steps.slice(-STEPS_SHOWN);
    const sure = shown.slice(1).reduce((all, step) => all * step.probability, 1);
    const marked = name === this.marked;
    return h(
      "a",
      { href: marked ? link("map") : link("walk", name), "aria-current": marked ? "true" : null },
      steps.length > shown.length ? "… → " : null,
      shown.map((step, k) => [
        k ? " → " : null,
        h("span", { class: "step" }, this.#picture(step.camera), h("b", {}, step.camera), ` ${clock(step.t)}`),
      ]),
      h("span", { class: "quiet", title: "Probability that all of this is one walk" }, `, ${percent(sure)}`),
    );
  }
}
