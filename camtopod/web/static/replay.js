// Replays the last hour in a minute, or the map version by version, with a slider. Live updates wait meanwhile.

import { fill, h } from "./dom.js";
import { writeCounts } from "./hours.js";
import { Away } from "./source.js";
import { clock, count } from "./words.js";

const SPEED = 60; // of the last hour
const PLAYS_SECONDS_MIN = 10;
const BAR_STEPS = 1000;
const COUNT_MILLISECONDS = 200; // between two updates of the counts
const STEP_PLAYS_SECONDS = 0.6; // a version
const WAY_SECONDS_MIN = 0.4; // of a dot, from camera to camera
const LIKELY = 0.5; // probability above which an entry continues the walk of a passage

export class Replay {
  on = false;
  #frame = 0;
  #isAsking = false;
  #shift = null; // moves the replay to a share of its duration

  constructor(app) {
    this.app = app;
    const button = (text, act) => h("button", { type: "button", on: { click: () => this.#start(act) } }, text);
    const stop = h("button", { type: "button", on: { click: () => this.stop() } }, "Stop");
    this.time = h("span", {});
    this.bar = h("input", {
      type: "range",
      max: BAR_STEPS,
      "aria-label": "Time of the replay",
      on: { input: () => this.#shift(this.bar.value / BAR_STEPS) },
    });
    this.playing = h("div", { hidden: true }, this.bar, stop, " ", this.time);
    this.said = h("p", { class: "quiet", role: "status" });
    const { hasRecent, hasGrowth, live } = app.source;
    this.offered = h(
      "div",
      {},
      hasRecent ? button("The last hour in a minute", () => this.#hour()) : null,
      hasGrowth ? button("The map, version by version", () => this.#grow()) : null,
      hasRecent && live ? h("p", { class: "quiet" }, "In it, dots are walks.") : null,
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
    if (map) network.update(map);
    if (this.fitted) network.fit();
    this.fitted = false;
    this.app.showToday();
  }

  async #start(act) {
    if (this.#isAsking) return;
    this.#isAsking = true;
    this.stop();
    fill(this.said);
    try {
      await act();
    } catch (error) {
      if (!(error instanceof Away)) throw error;
      fill(this.said, error.message);
    } finally {
      this.#isAsking = false;
    }
  }

  async #hour() {
    const { source } = this.app;
    const [{ events }, matches] = await Promise.all([source.recent(), source.walks(true)]);
    if (!events.length) return fill(this.said, "There was nothing in the last hour.");
    const { network } = this.app;
    const { flow, pulses } = network;
    const times = events.map((event) => event.t);
    const [from, until] = [times.reduce((a, b) => Math.min(a, b)), 1 + times.reduce((a, b) => Math.max(a, b))];
    const takes = Math.max(PLAYS_SECONDS_MIN, (until - from) / SPEED);
    const speed = (until - from) / takes;
    const acts = [
      ...events.map((event) => [event.t, () => pulses.show(event)]),
      ...matches
        .filter(({ t, from: [before] }) => t >= from && before?.probability > LIKELY)
        .map(({ camera, t, from: [before] }) => [
          Math.min(before.t, t),
          () => flow.go(before.camera, camera, Math.max(WAY_SECONDS_MIN, Math.abs(t - before.t) / speed)),
        ]),
    ];
    acts.sort(([one], [other]) => one - other);
    let updated = -Infinity;
    const label = (at) => {
      if (performance.now() - updated < COUNT_MILLISECONDS) return clock(at);
      updated = performance.now();
      const counts = new Map();
      for (const { camera, kind, t } of events)
        if (t <= at) (counts.get(camera) ?? counts.set(camera, [0, 0]).get(camera))[kind === "exit" ? 1 : 0] += 1;
      writeCounts(network, (id) => counts.get(id) ?? [0, 0], "in the replay");
      return clock(at);
    };
    return this.#play(acts, from, until, takes, label);
  }

  async #grow() {
    const steps = await this.app.source.growth();
    if (!steps.length) return fill(this.said, "Nothing has been learned yet.");
    const { network, map } = this.app;
    this.fitted = !network.view.touched;
    network.view.touched = true; // the map keeps its place
    const acts = steps.map((step, k) => [k, () => network.update(asOf(step, map))]);
    const words = (k) => {
      const { version, as_of: t } = steps[Math.min(steps.length - 1, Math.floor(k))];
      return `version ${count(version)}, ${clock(t)}`;
    };
    return this.#play(acts, 0, steps.length + 1, (steps.length + 1) * STEP_PLAYS_SECONDS, words);
  }

  // Runs `acts`, each [time, function], from one time to another within `seconds`; label(at): the text of a time.
  #play(acts, from, until, seconds, label) {
    const { flow } = this.app.network;
    this.on = true;
    this.playing.hidden = false;
    this.offered.hidden = true;
    this.bar.focus({ preventScroll: true });
    flow.clear(); // of live movements
    let begun = performance.now();
    let k = 0;
    this.#shift = (share) => {
      begun = performance.now() - 1000 * share * seconds;
      flow.clear();
      k = acts.filter(([t]) => t <= from + share * (until - from)).length;
      k = Math.max(0, k - 1); // repeats the last act, which draws the map of that moment
    };
    const step = () => {
      const share = Math.min(1, (performance.now() - begun) / 1000 / seconds);
      const at = from + share * (until - from);
      for (; k < acts.length && acts[k][0] <= at; k += 1) acts[k][1]();
      this.time.textContent = label(at);
      this.bar.value = share * BAR_STEPS;
      if (share < 1) this.#frame = requestAnimationFrame(step);
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
