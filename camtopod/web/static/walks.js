// Recent walks, newest first: entries that are of one object by their times. Each leads to its way on the map.

import { fill, h } from "./dom.js";
import { go, link } from "./place.js";
import { clock, percent } from "./words.js";

const ENTRIES_MAX = 3000; // remembered
const SHOWN = 6;
const STEPS_SHOWN = 4; // the newest of a walk
const LIST_MILLISECONDS = 700; // no list is read that changes faster

export class Walks {
  #entries = new Map(); // key -> {camera, t, walk, probability}
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
  add({ camera, t, passage, walk, from }) {
    const continues = from.length > 0 && !isAt({ camera, t }, beginOf(walk));
    if (continues) this.#rename(walk);
    this.#entries.set(`${camera} ${t} ${passage}`, { camera, t, walk, probability: continues ? from[0].probability : 1 });
    if (this.#entries.size > ENTRIES_MAX) this.#entries.delete(this.#entries.keys().next().value);
    this.#timer ??= setTimeout(() => this.#draw(), LIST_MILLISECONDS);
    return continues;
  }

  // Give the walk that now is named by one of its entries that name: that of its oldest passage of the last hour.
  #rename(walk) {
    const entries = [...this.#entries.values()];
    if (entries.some((one) => one.walk === walk)) return;
    const begin = beginOf(walk);
    const [first, another] = entries.filter((one) => isAt(one, begin));
    if (!first || another) return; // two begin in one picture
    const before = first.walk;
    for (const one of entries) if (one.walk === before && one.t >= first.t) one.walk = walk;
  }

  // Walks by name: their steps, oldest first.
  #walks() {
    const walks = new Map();
    for (const one of this.#entries.values()) {
      if (!walks.has(one.walk)) walks.set(one.walk, []);
      walks.get(one.walk).push(one);
    }
    for (const [name, steps] of walks) {
      const begin = beginOf(name);
      if (!steps.some((one) => isAt(one, begin))) steps.push(begin);
      steps.sort((one, other) => one.t - other.t);
    }
    return walks;
  }

  // Forget the walks through any of the cameras, the keys of `names`.
  forget(names) {
    for (const [name, steps] of this.#walks()) {
      if (!steps.some((step) => Object.hasOwn(names, step.camera))) continue;
      for (const [key, { walk }] of this.#entries) if (walk === name) this.#entries.delete(key);
      if (name === this.marked) go("map");
      this.#timer ??= setTimeout(() => this.#draw(), LIST_MILLISECONDS);
    }
  }

  // Mark a walk in the list, or none; its cameras.
  mark(name) {
    this.marked = name;
    this.#draw();
    return (this.#walks().get(name) ?? []).map((step) => step.camera);
  }

  #draw() {
    clearTimeout(this.#timer);
    this.#timer = null;
    const all = [...this.#walks()].filter(([, steps]) => steps.length > 1);
    all.sort(([, one], [, other]) => other.at(-1).t - one.at(-1).t);
    const shown = all.filter(([name], k) => k < SHOWN || name === this.marked);
    this.element.hidden = !shown.length;
    fill(this.list, shown.map(([name, steps]) => h("li", {}, this.#walk(name, steps))));
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

// A walk's name is the camera and the time of its begin, with a number if others begin then.
function beginOf(walk) {
  const [camera, t] = walk.split(/[@/]/);
  return { camera, t: Number(t), probability: 1 };
}

function isAt(one, other) {
  return one.camera === other.camera && Math.abs(one.t - other.t) < 0.001;
}
