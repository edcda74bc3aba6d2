// The last hour in a minute, and the map version by version. What is live waits meanwhile.

import { fill, h } from "./dom.js";
import { Away } from "./source.js";
import { clock, count } from "./words.js";

const HOUR_SECONDS = 3600;
const HOUR_PLAYS_SECONDS = 60;
const STEP_PLAYS_SECONDS = 0.6; // a version
const WAY_SECONDS_MIN = 0.4; // of a dot, from camera to camera

export class Replay {
  on = false;
  #frame = 0;

  constructor(app) {
    this.app = app;
    const button = (text, act) => h("button", { type: "button", on: { click: () => this.#start(act) } }, text);
    const stop = h("button", { type: "button", on: { click: () => this.stop() } }, "Stop");
    this.time = h("span", {});
    this.playing = h("p", { hidden: true }, stop, " ", this.time);
    this.said = h("p", { class: "quiet", role: "status" });
    const { hasRecent, hasGrowth, live } = app.source;
    this.offered = h(
      "div",
      {},
      hasRecent ? button("The last hour in a minute", () => this.#hour()) : null,
      hasGrowth ? button("The map, version by version", () => this.#grow()) : null,
      hasRecent ? h("p", { class: "quiet" }, "In it, dots join exits with the entries that fit best by the times of the links.") : null,
      live ? h("p", {}, h("a", { href: "report.html", download: true }, "All of this as one file")) : null,
    );
    this.element = h(
      "details",
      { class: "overlay replay", name: "news", hidden: !hasRecent && !hasGrowth },
      h("summary", {}, "Replay"),
      this.offered,
      this.playing,
      this.said,
    );
  }

  stop() {
    if (!this.on) return;
    cancelAnimationFrame(this.#frame);
    this.on = false;
    this.playing.hidden = true;
    this.offered.hidden = false;
    const { network, map } = this.app;
    network.flow.clear();
    network.update(map);
    if (this.fitted) network.fit();
  }

  async #start(act) {
    this.stop();
    if (!this.app.map?.version) return fill(this.said, "Nothing has been learned yet.");
    fill(this.said);
    try {
      await act();
    } catch (error) {
      if (!(error instanceof Away)) throw error;
      fill(this.said, error.message);
    }
    return undefined;
  }

  async #hour() {
    const { t, events } = await this.app.source.recent();
    if (!events.length) return fill(this.said, "There was nothing in the last hour.");
    const { flow, pulses } = this.app.network;
    const speed = HOUR_SECONDS / HOUR_PLAYS_SECONDS;
    const acts = [
      ...events.map((event) => [event.t, () => pulses.show(event)]),
      ...joined(events, this.app.map.edges).map((way) => [
        way.t,
        () => flow.go(way.from, way.to, Math.max(WAY_SECONDS_MIN, way.takes / speed)),
      ]),
    ];
    acts.sort(([one], [other]) => one - other);
    return this.#play(acts, t - HOUR_SECONDS, t, HOUR_PLAYS_SECONDS, clock);
  }

  async #grow() {
    const steps = await this.app.source.growth();
    const { network, map } = this.app;
    const acts = steps.map((step, k) => [k, () => network.update(asOf(step, map))]);
    const words = (k) => {
      const { version, as_of: t } = steps[Math.min(steps.length - 1, Math.floor(k))];
      return `version ${count(version)}, ${clock(t)}`;
    };
    this.#play(acts, 0, steps.length + 1, (steps.length + 1) * STEP_PLAYS_SECONDS, words);
  }

  // Do `acts`, each [time, what], from one time to another in so many seconds.
  #play(acts, from, until, seconds, words) {
    const { view } = this.app.network;
    this.fitted = !view.touched;
    view.touched = true; // the map stands still
    this.on = true;
    this.playing.hidden = false;
    this.offered.hidden = true;
    const begun = performance.now();
    let k = 0;
    const step = () => {
      const at = from + ((performance.now() - begun) / 1000) * ((until - from) / seconds);
      for (; k < acts.length && acts[k][0] <= at; k += 1) acts[k][1]();
      this.time.textContent = words(Math.min(at, until));
      if (at < until) this.#frame = requestAnimationFrame(step);
      else this.stop();
    };
    step();
  }
}

// The newest map with what a version of before had of it.
function asOf({ cameras, pairs }, map) {
  const those = (all, has) => Object.fromEntries(Object.entries(all).filter(([key]) => has(key)));
  const edges = those(map.edges, (key) => Object.hasOwn(pairs, key));
  return {
    ...map,
    cameras: those(map.cameras, (id) => cameras.includes(id)),
    edges: Object.fromEntries(Object.entries(edges).map(([key, edge]) => [key, { ...edge, relation: pairs[key] }])),
  };
}

// Ways between cameras, {from, to, t, takes}: each entry with the exit that fits best by the transit times of the links.
function joined(events, edges) {
  const inTime = [...events].sort((one, other) => one.t - other.t);
  const exits = Map.groupBy(inTime.filter(({ kind }) => kind === "exit"), ({ camera }) => camera);
  const ways = Object.values(edges).flatMap((edge) => (edge.published ? edge.ways : []));
  const into = Map.groupBy(ways, ({ to }) => to);
  const taken = new Set();
  const found = [];
  for (const entry of inTime.filter(({ kind }) => kind === "entry")) {
    let best = null;
    let least = Infinity;
    for (const { from, transit } of into.get(entry.camera) ?? []) {
      const those = exits.get(from) ?? [];
      for (let k = firstFrom(those, entry.t - transit.q90); k < those.length && those[k].t <= entry.t - transit.q10; k += 1) {
        const off = Math.abs(entry.t - those[k].t - transit.mode) / (transit.q90 - transit.q10);
        if (off < least && !taken.has(those[k])) [best, least] = [those[k], off];
      }
    }
    if (!best) continue;
    taken.add(best);
    found.push({ from: best.camera, to: entry.camera, t: Math.min(best.t, entry.t), takes: Math.abs(entry.t - best.t) });
  }
  return found;
}

// The first of some events, by time, that is not before `t`.
function firstFrom(events, t) {
  let [low, high] = [0, events.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (events[middle].t < t) low = middle + 1;
    else high = middle;
  }
  return low;
}
