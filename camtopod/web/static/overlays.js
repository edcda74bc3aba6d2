// What lies on the map: the search field, zoom buttons, the legend and the newest predictions.

import { fill, h, say } from "./dom.js";
import { go, link } from "./place.js";
import { ago, clock, count, plural } from "./words.js";

const OPEN_MAX = 100; // cameras; on the map of a larger site the predictions' list would hide too much
const HITS_SHOWN = 8;
const PREDICTIONS_SHOWN = 5;
const PREDICTION_SECONDS_MIN = 10; // that a prediction stays in the list at least
const ALARMS_SHOWN = 4;
const LIST_MILLISECONDS = 700; // no list is read that changes faster
const FIRST = "Learning: the first map comes within a minute of the first entry or exit.";
const NARROW = matchMedia("(max-width: 720px)");

// What the legend explains while it is in use: look, words, and whether `used` has it.
/** @type {[string, string, (used: any) => any][]} */
const SIGNS = [
  ["stroke overlapped", "views overlap", (used) => used.overlapped],
  ["stroke unseen", "unseen path", (used) => used.unseen],
  ["stroke unseen provisional", "provisional", (used) => used.provisional],
  ["stroke unseen likely", "likely, not published yet", (used) => used.likely],
  ["stroke wide", "wider: more traffic", (used) => used.overlapped + used.unseen > 1],
  ["swatch entry", "entry", (used) => used.live],
  ["swatch exit", "exit", (used) => used.live],
  ["swatch dot", "predicted, under way", (used) => used.live],
  ["swatch walk", "a walk goes on", (used) => used.live],
  ["swatch sees", "sees who just left another view", (used) => used.live && used.overlapped],
  ["swatch ill", "needs attention", (used) => used.ill],
  ["swatch gone", "gone", (used) => used.gone],
];

export class Overlays {
  #predictions = [];
  #timer = null;
  #shown = false;
  #gone = new Set(); // ids of cameras that are gone, on the map or not

  constructor(stage, app) {
    this.app = app;
    this.search = h("input", {
      type: "search",
      placeholder: "Find a camera",
      "aria-label": "Find a camera",
      autocomplete: "off",
      on: {
        input: () => this.#find(),
        keydown: (event) => this.#key(event),
        focus: () => this.#find(),
      },
    });
    this.hits = h("ul", { class: "hits" });
    this.said = h("span", { class: "visually-hidden", role: "status" });
    const { view } = app.network;
    const button = (text, name, act) =>
      h("button", { type: "button", "aria-label": name, title: name, on: { click: act } }, text);
    this.summary = h("span", { class: "quiet" });
    this.list = h("ul", {});
    this.newest = h("ul", {});
    this.alarmed = h("summary", {}, "");
    this.alarms = h("details", { class: "overlay", hidden: true }, this.alarmed, this.newest);
    this.predictions = h(
      "details",
      { class: "overlay predictions", name: "news", open: !NARROW.matches, hidden: true },
      h("summary", {}, "Predictions"),
      this.list,
    );
    this.counted = h("li", { class: "quiet", hidden: !app.source.live });
    this.waiting = h("p", { class: "overlay waiting", role: "status", hidden: true });
    this.signs = SIGNS.map(([look, words]) => h("li", { hidden: true }, h("i", { class: look }), words));
    this.legend = h(
      "details",
      { class: "overlay key" },
      h("summary", {}, "Legend ", this.summary),
      h(
        "ul",
        {},
        this.signs,
        this.counted,
        h("li", { class: "quiet" }, "numbers: most frequent transit time, with arrows where the directions differ"),
      ),
    );
    const zoom = h(
      "div",
      { class: "overlay zoom" },
      button("+", "Zoom in", () => view.zoom(1.4)),
      button("−", "Zoom out", () => view.zoom(1 / 1.4)),
      button("⤢", "Show all", () => app.network.fit()),
    );
    this.stack = h("div", { class: "left" }, this.waiting, this.alarms, this.predictions, app.walks.element, app.replay.element);
    stage.append(
      h(
        "div",
        { class: "overlay search", role: "search", on: { focusout: (event) => this.#left(event) } },
        this.search,
        this.hits,
        this.said,
      ),
      zoom,
      this.legend,
      this.stack,
    );
    app.network.coveredBy(this.search, zoom, this.legend, ...this.stack.children); // not the search's hits, which pass
  }

  update(map) {
    if (!this.#shown && Object.keys(map.cameras).length > OPEN_MAX) this.predictions.open = false;
    this.#shown = true;
    this.#showAlarms(map.alarms);
    if (map.version) this.#wait(map.waiting);
    this.#summarise();
  }

  // Shows the number of events before the first version; events: one number for each camera.
  showEvents(events) {
    const heard = events.filter((n) => n > 0);
    const all = heard.reduce((sum, n) => sum + n, 0);
    const from = `${plural(heard.length, "camera")} so far.`;
    this.#wait(`${FIRST} ${heard.length ? `${plural(all, "event")} from ${from}` : "No camera has sent an event yet."}`);
  }

  // Of which day the numbers on the cameras are.
  showDay(when) {
    this.counted.textContent = `on a camera: entries ${when}`;
  }

  #wait(text) {
    this.waiting.hidden = !text;
    say(this.waiting, text);
  }

  // Which cameras are gone.
  showGone(ids) {
    this.#gone = ids;
    this.#summarise();
  }

  #summarise() {
    const { map } = this.app;
    if (!map) return;
    const edges = Object.values(map.edges).filter((edge) => edge.published);
    const likely = Object.keys(map.edges).length - edges.length;
    const overlapped = edges.filter((edge) => edge.relation === "overlapped").length;
    const provisional = edges.filter((edge) => edge.provisional).length;
    const kinds = `${count(overlapped)} overlapping${provisional ? `, ${count(provisional)} provisional` : ""}`;
    const ids = Object.keys(map.cameras);
    const gone = ids.filter((id) => this.#gone.has(id)).length;
    const ill = ids.some((id) => this.app.rows.get(id)?.look === "bad");
    const unseen = edges.length - overlapped;
    const used = { overlapped, unseen, provisional, likely, ill, gone, live: this.app.source.live };
    for (const [k, [, , isUsed]] of SIGNS.entries()) this.signs[k].hidden = !isUsed(used);
    this.summary.textContent = [
      plural(ids.length - gone, "camera"),
      gone ? `${count(gone)} gone` : null,
      `${plural(edges.length, "pair")} (${kinds})`,
      likely ? `${count(likely)} likely` : null,
    ]
      .filter(Boolean)
      .join(", ");
  }

  predicted(prediction) {
    const { camera, t, place, words } = prediction;
    if (place === camera) return; // the object stays where it is on the map
    if (this.#predictions.some((one) => one.camera === camera && one.t === t && one.words === words)) return; // sent again
    this.#predictions = [{ ...prediction, heard: performance.now() }, ...this.#predictions].slice(0, PREDICTIONS_SHOWN);
    this.#timer ??= setTimeout(() => this.#list(), LIST_MILLISECONDS);
  }

  // Removes predictions whose windows have all passed, and says how old the others are.
  listPredictions() {
    const current = this.#predictions.filter((one) => this.#age(one) < Math.max(PREDICTION_SECONDS_MIN, one.seconds));
    const isSame = current.length === this.#predictions.length;
    this.#predictions = current;
    if (!isSame) this.#list();
    else if (!this.#timer)
      for (const [k, age] of [...this.list.querySelectorAll(".age")].entries()) age.textContent = ago(this.#age(current[k]));
  }

  // Seconds since the exit; those since it was heard of if they are more, as the time of a recording ends with it.
  #age({ t, heard }) {
    return Math.max(this.app.present() - t, (performance.now() - heard) / 1000);
  }

  #showAlarms(all) {
    const alarms = all.filter((alarm) => alarm.open);
    this.alarms.hidden = !alarms.length;
    this.alarmed.textContent = plural(alarms.length, "alarm");
    fill(
      this.newest,
      alarms
        .slice(0, ALARMS_SHOWN)
        .map((alarm) =>
          h(
            "li",
            {},
            h("b", {}, alarm.title),
            " ",
            h("span", { class: "quiet" }, clock(alarm.t)),
            h("small", {}, alarm.detail),
          ),
        ),
      h("li", {}, h("a", { href: link("versions") }, "All, with the versions that raised them")),
    );
  }

  #list() {
    this.#timer = null;
    this.predictions.hidden = false;
    fill(
      this.list,
      this.#predictions.length ? null : h("li", { class: "quiet" }, "No open predictions."),
      this.#predictions.map((one) =>
        h(
          "li",
          {},
          h("span", {}, h("a", { href: link("camera", one.camera) }, one.camera), " → ", h("span", { class: "quiet" }, one.words)),
          h("span", { class: "age quiet" }, ago(this.#age(one))),
        ),
      ),
    );
  }

  #find() {
    const found = this.app.network.search(this.search.value);
    if (found === null) {
      say(this.said, "");
      fill(this.hits);
      return;
    }
    say(this.said, `${plural(found.length, "camera")} found`);
    fill(
      this.hits,
      found
        .slice(0, HITS_SHOWN)
        .map((id) => h("li", {}, h("a", { href: link("camera", id), on: { click: () => this.#chose(id) } }, id))),
      found.length > HITS_SHOWN ? h("li", { class: "quiet" }, `and ${count(found.length - HITS_SHOWN)} more`) : null,
      found.length ? null : h("li", { class: "quiet" }, "No matching camera"),
    );
  }

  #key(event) {
    if (event.key !== "Enter") return;
    const [first] = this.app.network.search(this.search.value) ?? [];
    if (!first) return;
    this.#chose(first);
    go("camera", first);
  }

  #chose(id) {
    this.search.value = "";
    this.#find();
    this.app.network.show(id);
  }

  #left(event) {
    if (!event.currentTarget.contains(event.relatedTarget)) fill(this.hits);
  }
}
