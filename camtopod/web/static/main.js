// The page: what the address names is shown, and everything stays live.

import { cameraPanel } from "./camera.js";
import { fill, h } from "./dom.js";
import { Health } from "./health.js";
import { linkPanel, pairPanel } from "./link.js";
import { Connection } from "./live.js";
import { Overlays } from "./overlays.js";
import { NetworkMap } from "./map.js";
import { go, here, link } from "./place.js";
import { NotThere, openSource } from "./source.js";
import { LinkTable } from "./table.js";
import { Versions } from "./versions.js";
import { ago, clock, count, troubled } from "./words.js";

const PANELS = { camera: cameraPanel, pair: pairPanel, link: linkPanel };
const RETRY_MILLISECONDS = 2000;

class App {
  map = null; // the newest version's, as the server draws it
  rows = new Map(); // camera -> its health
  #shown = null; // the panel that is open
  #lost = null; // since when the server is not reached
  #daemon = null; // what the server says of the daemon
  #place = "";
  #told = h("span", {});
  #age = h("span", { "aria-hidden": "true" }); // a screen reader need not say every second

  constructor() {
    this.source = openSource();
    this.banner = h("div", { class: "banner", role: "alert", hidden: true }, this.#told, this.#age);
    this.pill = h("span", { class: "pill off", id: "live" }, "…");
    this.title = h("span", { class: "site" });
    this.stage = h("div", { class: "stage" });
    this.panel = h("aside", { class: "panel", hidden: true, tabindex: "-1", "aria-label": "Details" });
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
      h("a", { class: "skip", href: "#/links" }, "Links as a table"),
      h("header", {}, h("a", { class: "brand", href: "#/map" }, "camtopod"), this.title, this.nav, this.pill),
      this.banner,
      h("main", {}, this.stage, this.panel, this.pages),
    );
    this.network = new NetworkMap(this.stage);
    this.overlays = new Overlays(this.stage, this);
    this.views = { links: new LinkTable(), versions: new Versions(this) };
    if (this.source.live) this.views.health = new Health(this);
    addEventListener("hashchange", () => this.route());
    addEventListener("keydown", (event) => this.#key(event));
  }

  async start() {
    if (this.source.live) {
      this.connection = new Connection({
        map: (change) => this.#change(change),
        resync: () => this.load(),
        version: (version) => {
          if (!this.#has(version)) this.load();
        },
        live: (said) => {
          this.#daemon = said;
          this.#tellLive();
        },
        lost: (since) => {
          this.#lost = since;
          this.#tellLive();
        },
        prediction: (prediction) => this.#predicted(prediction, true),
        past: (prediction) => this.#predicted(prediction, false),
        event: (event) => this.#shown?.onEvent?.(event),
        health: (row) => this.heardHealth([row], row.at),
      });
      setInterval(() => this.#tellLive(), 1000);
    }
    await this.load();
    this.#tellLive();
    await this.route();
    if (!this.source.live) return;
    const { cameras, now } = await this.source.health();
    this.heardHealth(cameras, now);
  }

  // Seconds since the epoch by the server's clock.
  now() {
    return this.connection ? this.connection.now() : (this.map?.as_of ?? 0);
  }

  // Fetch the whole map, again if the server is away.
  async load() {
    try {
      this.#use(await this.source.map());
    } catch (error) {
      if (!(error instanceof TypeError || error instanceof SyntaxError)) throw error;
      setTimeout(() => this.load(), RETRY_MILLISECONDS);
    }
  }

  // Rows of the health page as they were at a time; one that is older than what is known says nothing new.
  heardHealth(rows, at) {
    for (const row of rows) {
      const known = this.rows.get(row.id);
      if (!known || known.at <= at) this.rows.set(row.id, { ...known, ...withValues(row), at });
    }
    this.network.health(new Set([...this.rows.values()].filter((row) => troubled(row.state)).map((row) => row.id)));
    this.#shown?.onHealth?.(this.rows);
  }

  // Show what the address names.
  async route() {
    const place = location.hash;
    this.#place = place;
    const [name, ...rest] = here();
    const page = this.views[name];
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
    } else if (name in PANELS) {
      await this.#open(name, rest, place);
    } else {
      this.#close();
      if (before && document.activeElement === document.body) this.network.focus(before.chosen[0]);
    }
  }

  async #open(name, rest, place, again = false) {
    let shown;
    try {
      shown = await PANELS[name](this, ...rest);
    } catch (error) {
      if (!(error instanceof NotThere || error instanceof TypeError)) throw error;
      if (again) return;
      const away = "The server is not reached.";
      shown = {
        kind: "Not there",
        title: rest[0] ?? name,
        chosen: [],
        body: [h("p", {}, error instanceof NotThere ? error.message : away)],
      };
    }
    if (this.#place !== place) return; // somebody has gone on meanwhile
    this.#shown = shown;
    const top = again ? this.panel.scrollTop : 0;
    fill(
      this.panel,
      h(
        "div",
        { class: "head" },
        h("div", {}, h("p", { class: "kind" }, shown.kind), h("h2", { tabindex: "-1" }, shown.title)),
        h("a", { class: "close", href: "#/map", "aria-label": "Close" }, "✕"),
      ),
      shown.body,
    );
    this.panel.hidden = false;
    this.panel.scrollTop = top;
    document.body.classList.add("with-panel");
    this.network.choose(...shown.chosen);
    this.connection?.watch(shown.watch ?? null);
    shown.onHealth?.(this.rows);
    if (!again) this.panel.querySelector("h2").focus({ preventScroll: true });
  }

  #close() {
    this.#shown = null;
    this.panel.hidden = true;
    document.body.classList.remove("with-panel");
    this.network.choose();
    this.connection?.watch(null);
  }

  #has(version) {
    return version === null ? this.map === null : this.map?.epoch === version[0] && this.map.version === version[1];
  }

  #change(change) {
    if (!this.#has([change.epoch, change.since])) return this.load();
    const cameras = { ...this.map.cameras, ...change.cameras };
    const edges = { ...this.map.edges, ...change.edges };
    for (const id of change.gone_cameras) delete cameras[id];
    for (const key of change.gone_edges) delete edges[key];
    return this.#use({ ...change, cameras, edges });
  }

  #use(map) {
    const before = this.map;
    this.map = map;
    if (!map) return;
    this.title.textContent = map.site;
    document.title = `${map.site} · camtopod`;
    this.network.update(map);
    this.overlays.update(map);
    for (const view of Object.values(this.views)) view.update?.(map);
    this.#tellLive();
    const [name, ...rest] = here();
    if (before && this.#shown && name in PANELS && name !== "camera") this.#open(name, rest, location.hash, true);
  }

  #predicted(prediction, live) {
    if (live) this.network.flow.send(prediction, this.now() - prediction.t);
    this.overlays.predicted(prediction);
    if (live) this.#shown?.onPrediction?.(prediction);
  }

  #tellLive() {
    const version = this.map ? `version ${count(this.map.version)}` : "no version yet";
    if (!this.source.live) {
      this.pill.textContent = `report, ${version}, ${clock(this.map.as_of)}`;
      return;
    }
    const since = this.#lost ?? (this.#daemon && !this.#daemon.live ? this.#daemon.since : null);
    this.pill.className = `pill ${since === null ? (this.#daemon ? "good" : "off") : "bad"}`;
    this.pill.textContent = since === null ? (this.#daemon ? `live · ${version}` : "…") : `not live · ${version}`;
    this.banner.hidden = since === null;
    document.body.classList.toggle("stale", since !== null);
    if (since === null) return;
    const reason = this.#lost !== null ? "this page does not reach its server" : this.#daemon.reason;
    const what = this.map ? `Map, predictions and health stand still at ${version}.` : "Nothing is known yet.";
    const text = `Not live since ${clock(since)}: ${reason}. ${what} It goes on by itself. `;
    if (this.#told.textContent !== text) this.#told.textContent = text;
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

function withValues(row) {
  return Object.fromEntries(Object.entries(row).filter(([, value]) => value !== null));
}

new App().start();
