// The floor plan beneath the map: where on it cameras are, and below it those that have no place. They are dragged to
// their places while `panel` is open, which offers these for the configuration: the page itself changes nothing.

import { h, s } from "./dom.js";

const WIDE = 8; // hops that the plan is wide
const ROW = 8; // cameras in a row below it

// A plan once its picture is there, or null if it cannot be loaded.
export function openPlan({ href, at }) {
  return new Promise((ready) => {
    const image = new Image();
    image.addEventListener("load", () => ready(new Plan(href, at, image.naturalHeight / image.naturalWidth)));
    image.addEventListener("error", () => ready(null));
    image.src = href;
  });
}

class Plan {
  #moved = new Set();
  #toml = h("pre", { tabindex: 0, "aria-label": "Places for the configuration" });
  #copy = h("button", { type: "button", hidden: true, on: { click: () => this.#copied() } }, "Copy");
  panel = h(
    "details",
    { class: "overlay places", name: "news" },
    h("summary", {}, "Place cameras"),
    h("p", {}, "Drag them, or Shift and arrow keys; then put each “at” into its camera's table of the configuration."),
    this.#toml,
    this.#copy,
  );

  constructor(href, at, ratio) {
    this.at = at;
    this.width = WIDE;
    this.height = WIDE * ratio;
    this.element = s("image", { class: "plan", href, preserveAspectRatio: "none" });
  }

  // Where the cameras are, in hops: id -> [x, y].
  places(ids) {
    const rest = ids.filter((id) => !Object.hasOwn(this.at, id)).sort();
    return new Map(
      ids.map((id) => {
        if (Object.hasOwn(this.at, id)) return [id, [this.at[id][0] * this.width, this.at[id][1] * this.height]];
        const k = rest.indexOf(id);
        return [id, [(k % ROW) + 0.5, this.height + 0.6 + 0.9 * Math.floor(k / ROW)]];
      }),
    );
  }
  // Whether cameras are moved now.
  get placing() {
    return this.panel.open;
  }

  // Put a camera at a place in hops.
  move(id, [x, y]) {
    const share = (value) => Number(Math.min(1, Math.max(0, value)).toFixed(3));
    this.at[id] = [share(x / this.width), share(y / this.height)];
    this.#moved.add(id);
    const key = (name) => (/^[\w-]+$/.test(name) ? name : JSON.stringify(name));
    this.#toml.textContent = [...this.#moved].map((one) => `[cameras.${key(one)}]\nat = [${this.at[one].join(", ")}]\n`).join("\n");
    this.#copy.textContent = "Copy";
    this.#copy.hidden = false;
  }

  // Into the clipboard, or, where the browser has none for this page, marked for the keys that copy.
  #copied() {
    getSelection().selectAllChildren(this.#toml);
    navigator.clipboard?.writeText(this.#toml.textContent).then(() => (this.#copy.textContent = "Copied"));
  }
}
