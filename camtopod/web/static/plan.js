// The floor plan beneath the map: where on it cameras are, and below it those that have no place.

import { s } from "./dom.js";

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
}
