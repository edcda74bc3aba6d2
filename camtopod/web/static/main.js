// The page: what the address names is shown, and everything stays live.

import { cameraPanel } from "./camera.js";
import { fill, h, say } from "./dom.js";
import { Health } from "./health.js";
import { Hours, writeCounts } from "./hours.js";
import { linkPanel, pairPanel } from "./link.js";
import { Connection } from "./live.js";
import { Overlays } from "./overlays.js";
import { NetworkMap } from "./map.js";
import { openPlan } from "./plan.js";
import { go, here, link } from "./place.js";
import { Replay } from "./replay.js";
import { Away, NotThere, openSource } from "./source.js";
import { LinkTable } from "./table.js";
import { Versions } from "./versions.js";
import { Walks } from "./walks.js";
import { ago, clock, count, day } from "./words.js";

const PANELS = { camera: cameraPanel, pair: pairPanel, link: linkPanel };
const RETRY_MILLISECONDS = 2000;
const HEALTH_MILLISECONDS = 4000;
const CATCH_UP_MILLISECONDS = 60_000;
const OLD_SECONDS = 86_400; // age of the newest event from which on a site without a grabber plays a recording
const FRESH_SECONDS = 30; // age of an event up to which it is a pulse

class App {
  map = null; // the newest version's, as the server draws it
  health = null; // of the daemon and the cameras, as asked for last
  rows = new Map(); // camera -> its health
  hours = new Hours();
  recorded = null; // time of the newest event of a recording that is played; null of a site that is live
  #shown = null; // the panel that is open
  #lost = null; // since when the server is not reached, or refuses this page
  #refused = ""; // why it does
  #loading = null; // the first map; what is said of versions meanwhile is held against it
  #place = "";
  #asked = 0; // how often the map or a panel was asked for
  #used = 0; // of which time the map is that is shown
  #opened = 0; // the same of the panel
  #text = h("span", {});
  #age = h("span", { "aria-hidden": "true" }); // a screen reader need not say every second

  constructor() {
    this.source = openSource();
    this.banner = h("div", { class: "banner", role: "alert", hidden: true }, this.#text, this.#age);
    const href = this.source.live ? link("health") : null;
    this.pill = h("a", { class: "pill off", id: "live", href, tabindex: "-1" }, "…"); // keys have the link beside it
    this.title = h("span", { class: "site" });
    this.stage = h("div", { class: "stage" }, h("h1", { class: "visually-hidden" }, "Map of the cameras"));
    this.panel = h("aside", { class: "panel", hidden: true, tabindex: "-1", "aria-label": "Details" });
    this.inPanel = h("div", {});
    this.pages = h("div", { class: "pages", hidden: true });
    this.nav = h(
      "nav",
      { "aria-label": "Views" },
      [
        ["map", "Map"],
        ["links", "Links"],
        ["versions", "Versions"],
        ["health", "Health"],
      ]
        .filter(([name]) => this.source.live || name !== "health")
        .map(([name, text]) => h("a", { href: link(name), data: { name } }, text)),
    );
    document.body.append(
      h("header", {}, h("a", { class: "skip", href: "#/links" }, "Links as a table"), h("a", { class: "brand", href: "#/map" }, "camtopod"), this.title, this.nav, this.pill),
      this.banner,
      h("main", {}, this.stage, this.panel, this.pages),
    );
    this.network = new NetworkMap(this.stage);
    this.walks = new Walks((id) => this.network.pictures.get(id));
    this.replay = new Replay(this);
    this.overlays = new Overlays(this.stage, this);
    /** @type {Record<string, any>} */
    this.views = { links: new LinkTable(), versions: new Versions(this) };
    if (this.source.live) this.views.health = new Health(this);
    addEventListener("hashchange", () => this.route());
    addEventListener("keydown", (event) => this.#key(event));
  }

  async start() {
    if (this.source.live) {
      this.connection = new Connection({
        // the newest one, of a new connection, too: what was missed meanwhile is fetched
        version: async (version) => {
          await this.#loading;
          if (!this.#has(version)) this.load();
          else if (!this.#shown || this.#shown.failed) this.#again();
          this.askHealth();
          this.#catchUp();
        },
        cameras: () => this.load(), // one has come that no version knows yet
        lost: (since, why) => {
          this.#lost = since;
          this.#refused = why;
          this.#showLive();
        },
        prediction: (prediction) => this.#predicted(prediction, true),
        past: (prediction) => this.#predicted(prediction, false),
        match: (match) => this.#matched(match),
        seen: (events) => events.forEach((event) => this.#seen(event)),
      });
      setInterval(() => {
        this.#showLive();
        this.showToday();
        this.overlays.listPredictions();
        this.#shown?.onTick?.();
      }, 1000);
      setInterval(() => document.hidden || this.askHealth(), HEALTH_MILLISECONDS);
      setInterval(() => document.hidden || this.#catchUp(), CATCH_UP_MILLISECONDS);
    }
    this.#loading = this.load();
    await this.#loading;
    this.#showLive();
    await this.route();
  }

  // What is drawn of camera `id`, if it is shown.
  scene(id) {
    return this.#shown?.scene?.story.id === id ? this.#shown.scene : null;
  }

  // Seconds since the epoch by the server's clock.
  now() {
    return this.connection ? this.connection.now() : (this.map?.as_of ?? 0);
  }

  #showRecording() {
    const newest = Math.max(this.#newest(), this.map?.as_of ?? 0);
    const isOld = newest && this.now() - newest > OLD_SECONDS;
    this.recorded = isOld && [...this.rows.values()].every((row) => !row.has_grabber) ? newest : null;
  }

  // Time of the newest event of all cameras, 0 if there is none.
  #newest() {
    return [...this.rows.values()].reduce((last, row) => Math.max(last, row.newest ?? 0), 0);
  }

  // The present of the site: now, or the time of the newest event of a recording.
  present() {
    return this.recorded ?? this.now();
  }

  // The age of a time in words; of a recording the time itself.
  age(t) {
    return this.recorded ? clock(t) : ago(this.now() - t);
  }

  // Shows the entries of today on the cameras, or of the day of a recording.
  showToday() {
    const when = this.recorded ? `on ${day(this.recorded)}` : "today";
    this.overlays.showDay(when);
    if (!this.replay.on) writeCounts(this.network, (id) => this.hours.today(id, this.present()), when);
  }

  // Fetch the whole map, again if the server is away.
  async load() {
    const asked = (this.#asked += 1);
    try {
      const { source } = this;
      const [map, pictures, plan] = await Promise.all([source.map(), source.pictures(), source.plan()]);
      if (plan && !this.network.plan) this.#usePlan(await openPlan(plan));
      if (asked < this.#used) return; // a newer answer came before
      this.#used = asked;
      this.network.pictures = new Map(pictures.map((id) => [id, this.source.picture(id)]));
      this.#use(map);
    } catch (error) {
      if (!(error instanceof Away)) throw error;
      setTimeout(() => this.load(), RETRY_MILLISECONDS);
    }
  }

  #usePlan(plan) {
    if (!plan || this.network.plan) return; // that of another answer came before
    this.network.plan = plan;
    this.overlays.stack.append(plan.panel);
    this.network.coveredBy(plan.panel);
  }

  // Number of objects between cameras; null without a daemon that counts them, or without events since it started.
  get between() {
    const between = this.health?.live.live ? this.health.daemon.between : null;
    return between && this.#newest() > between.since ? between : null;
  }

  // Ask for the health of the daemon and of every camera.
  async askHealth() {
    try {
      this.health = await this.source.health();
    } catch (error) {
      if (!(error instanceof Away)) throw error; // the server is away, which the banner says
      return;
    }
    this.walks.forget(this.health.daemon.names?.forgotten ?? {});
    const before = this.rows;
    this.rows = new Map(this.health.cameras.map((row) => [row.id, row]));
    for (const [id, row] of this.rows) {
      const known = before.get(id)?.newest ?? 0;
      if (known > row.newest) row.newest = known; // an event comes here before the daemon counts it
    }
    this.#showHealth();
    this.#showLive();
    this.views.health.update();
  }

  // Ask what the daemon has counted, and which walks there were.
  async #catchUp() {
    try {
      for (const match of await this.source.walks()) this.walks.add(match);
      if (this.hours.use(await this.source.hours())) this.#again(); // a camera may be open already
    } catch (error) {
      if (!(error instanceof Away)) throw error;
    }
  }

  #showHealth() {
    const those = (test) => new Set([...this.rows.values()].filter(test).map((row) => row.id));
    const gone = those((row) => row.state === "gone");
    this.network.health(those((row) => row.look === "bad"), gone);
    this.overlays.showGone(gone);
    this.network.showBetween(this.between?.pairs ?? []);
    if (!this.map?.version) this.overlays.showEvents([...this.rows.values()].map((row) => row.events ?? 0));
    this.#shown?.onHealth?.(this.rows);
  }

  // An entry or exit, told within a second.
  #seen(event) {
    this.#heardFrom(event);
    this.hours.add(event);
    if (!this.replay.on && this.present() - event.t < FRESH_SECONDS) this.network.pulses.show(event);
    this.#shown?.onEvent?.(event);
  }

  // What an entry is matched with.
  #matched(match) {
    if (this.walks.add(match) && !this.replay.on) this.network.flow.walk(match);
    if (match.walk === this.walks.marked) this.network.choose(...this.walks.mark(match.walk));
  }

  // Something has come from a camera.
  #heardFrom({ camera, t }) {
    const row = this.rows.get(camera);
    if (row) row.newest = Math.max(row.newest ?? 0, Math.min(t, this.now()));
  }

  // Show what the address names.
  async route() {
    const place = location.hash;
    this.#place = place;
    const [name, ...rest] = here();
    const page = Object.hasOwn(this.views, name) ? this.views[name] : null;
    const before = this.#shown;
    for (const a of this.nav.children) {
      if (a.dataset.name === name || (!page && a.dataset.name === "map")) a.setAttribute("aria-current", "page");
      else a.removeAttribute("aria-current");
    }
    for (const [other, view] of Object.entries(this.views)) if (other !== name) view.hidden?.();
    this.stage.hidden = Boolean(page);
    this.pages.hidden = !page;
    if (page) {
      this.#close();
      if (this.pages.firstChild !== page.element) fill(this.pages, page.element);
      await page.shown(...rest);
    } else if (Object.hasOwn(PANELS, name)) {
      await this.#open(name, rest, place);
    } else {
      this.#close();
      this.network.choose(...this.walks.mark(name === "walk" ? rest[0] : null));
      if (before && document.activeElement === document.body) this.network.focus(before.chosen[0]);
    }
  }

  async #open(name, rest, place, again = false) {
    const asked = (this.#asked += 1);
    let shown;
    try {
      shown = await PANELS[name](this, ...rest);
    } catch (error) {
      if (!(error instanceof NotThere || error instanceof Away)) throw error;
      if (again && error instanceof Away) return; // the panel stays as it is
      shown = {
        kind: "Not found",
        failed: true,
        title: rest[0] ?? name,
        chosen: [],
        body: [h("p", {}, error.message)],
      };
    }
    if (this.#place !== place || asked < this.#opened) return; // somebody has gone on, or a newer answer came before
    this.#opened = asked;
    const top = again ? this.panel.scrollTop : 0;
    fill(this.inPanel, shown.body);
    const isSame = again && this.#shown?.kind === shown.kind && this.#shown.title === shown.title;
    if (!isSame) fill(this.panel, headOf(shown), this.inPanel);
    this.#shown = shown;
    this.panel.hidden = false;
    this.panel.scrollTop = top;
    document.body.classList.add("with-panel");
    this.network.choose(...shown.chosen);
    shown.onHealth?.(this.rows);
    if (!again) this.panel.querySelector("h2").focus({ preventScroll: true });
  }

  #close() {
    this.#shown = null;
    this.panel.hidden = true;
    document.body.classList.remove("with-panel");
    this.network.choose();
  }

  #has(version) {
    return version === null ? !this.map?.version : this.map?.epoch === version[0] && this.map.version === version[1];
  }

  #use(map) {
    this.map = map;
    if (!map) return;
    this.title.textContent = map.site;
    document.title = `${map.site} · camtopod`;
    if (!this.replay.on) this.network.update(map); // else as it stops
    this.overlays.update(map);
    this.#showHealth();
    this.#again();
    this.#showLive();
  }

  // Fetch what is shown once more: it is of an older version, or could not be had before.
  #again() {
    for (const view of Object.values(this.views)) view.update?.(this.map);
    const [name, ...rest] = here();
    if (this.#shown && Object.hasOwn(PANELS, name)) this.#open(name, rest, location.hash, true);
  }

  #predicted(prediction, live) {
    this.#heardFrom(prediction);
    if (live && !this.replay.on) this.network.flow.send(prediction, this.present() - prediction.t);
    this.overlays.predicted(prediction);
    if (live) this.#shown?.onPrediction?.(prediction);
  }

  #showLive() {
    const version = this.map?.version ? `version ${count(this.map.version)}` : "no version yet";
    if (!this.source.live) {
      this.pill.textContent = `report, ${version}, ${clock(this.map.as_of)}`;
      return;
    }
    this.#showRecording();
    const live = this.health?.live;
    const since = this.#lost ?? (live && !live.live ? live.since : null);
    const ill = since === null && [...this.rows.values()].some((row) => row.look === "bad");
    this.pill.className = `pill ${since !== null ? "bad" : (live?.look ?? "off")}`;
    this.nav.querySelector("[data-name=health]").classList.toggle("ill", ill);
    const words = this.#lost === null ? live?.words : "not reached";
    const recording = this.recorded && `recording of ${day(this.recorded)}`;
    this.pill.textContent = words ? [words, recording, version].filter(Boolean).join(" · ") : "…";
    this.banner.hidden = since === null;
    document.body.classList.toggle("stale", since !== null);
    if (since === null) return;
    const lost = this.#refused || "this page cannot reach its server";
    const reason = this.#lost !== null ? lost : live.reason;
    const what = this.map ? `Map, predictions and health remain at ${version}.` : "Nothing has been received yet.";
    const text = `Not live since ${clock(since)}: ${reason}. ${what} It reconnects automatically. `;
    say(this.#text, text);
    this.#age.textContent = `(${ago(this.now() - since)})`;
  }

  #key(event) {
    const typing = event.target instanceof HTMLInputElement;
    if (event.key === "Escape") {
      if (typing && event.target.value) return; // the field clears itself
      if (!this.panel.hidden) {
        const [first] = this.#shown?.chosen ?? [];
        go("map");
        if (first) this.network.focus(first);
      } else if (typing) event.target.blur();
    } else if (event.key === "/" && !typing && !this.stage.hidden) {
      event.preventDefault();
      this.overlays.search.focus();
    }
  }
}

function headOf({ kind, title }) {
  return h(
    "div",
    { class: "head" },
    h("div", {}, h("p", { class: "kind" }, kind), h("h2", { tabindex: "-1" }, title)),
    h("a", { class: "close", href: "#/map", "aria-label": "Close" }, "✕"),
  );
}

new App().start();
