// A camera's page: its picture with the learned zones, who comes and goes, and its links.

import { fill, h, s } from "./dom.js";
import { hourChart } from "./hours.js";
import { Taken } from "./labels.js";
import { link } from "./place.js";
import { clock, count, percent, plural, seconds } from "./words.js";

const FRAME = [1600, 900]; // where there is no picture, pixels
const MARGINS = [0.06, 0.2]; // around the picture, of its width or height: zones lie on its edges
const SPREAD = 2; // standard deviations that a zone's ellipse shows
const PIXELS = [412, 480]; // of the panel: its width until it is shown; the height that a picture has at most
const COUNT_UNITS = 3.2; // half the width of a letter of a zone's counts, pixels
const NUMBER_UNITS = 8; // half the width of its number
const HEAD_BEFORE = 0.055; // a passage ends so much of the width before a zone's middle, for its head to be seen
const EVENTS_SHOWN = 40;
const PASSAGE_SHARE_MIN = 0.12;

// What the panel shows of camera `id`.
export async function cameraPanel(app, id) {
  const story = await app.source.camera(id);
  const picture = app.source.picture(id);
  const scene = app.scene(id)?.update(story, picture) ?? new Scene(story, picture);
  const status = h("div", { class: "status" });
  const recorder = story.page && h("a", { href: story.page, target: "_blank", rel: "noreferrer" }, "At the recorder ↗");
  const since = h("span", { class: "quiet" });
  const learned = h("dd", {});
  const showAges = () => {
    const newest = app.rows.get(id)?.newest;
    since.textContent = newest ? `last event ${app.age(newest)}` : "";
    const last = story.last_event;
    learned.textContent = !last ? "–" : app.source.live ? app.age(last) : clock(last);
  };
  showAges();
  const facts = h(
    "dl",
    { class: "figures" },
    fact("Zones", count(story.zones.length)),
    fact("Share of all events", percent(story.share)),
    h("div", {}, h("dt", {}, "Last learned event"), learned),
    fact(
      "Clock",
      clockText(story),
      "Offset of this camera's clock from the others', estimated from people walking both ways",
    ),
  );
  const hours = app.hours.of(id, app.present());
  const between = story.links.filter((one) => one.relation !== "visible" && camera(one.from) !== camera(one.to));
  const out = between.filter((one) => camera(one.from) === id).sort((a, b) => b.transitions - a.transitions);
  const into = between.filter((one) => camera(one.to) === id).sort((a, b) => b.transitions - a.transitions);
  return {
    kind: "Camera",
    title: id,
    chosen: [id],
    scene,
    body: [
      status,
      scene.element,
      recorder && h("p", {}, recorder),
      h(
        "p",
        { class: "legend" },
        key("entry", "entry"),
        key("exit", "exit"),
        h("span", {}, h("i", { class: "swatch zone" }), "learned zone"),
        app.source.live ? scene.pulse : null,
      ),
      facts,
      hours ? [h("h3", {}, "Events an hour"), hourChart(hours)] : null,
      h("h3", {}, "Zones"),
      zoneTable(story),
      h("h3", {}, "Where people go from here"),
      linkList(out, (one) => one.to, "No link leads from this camera."),
      h("h3", {}, "Where they come from"),
      linkList(into, (one) => one.from, "No link leads to this camera."),
      story.alarms.length ? [h("h3", {}, "Alarms"), alarmList(story.alarms)] : null,
    ],
    onEvent: (event) => event.camera === id && scene.add(event),
    onPrediction: (prediction) => {
      if (prediction.camera === id) scene.left(prediction);
      else scene.sees(prediction);
    },
    onHealth: (rows) => {
      showStatus(status, rows.get(id), since);
      showAges();
    },
    onTick: showAges,
  };
}

export function alarmList(alarms) {
  return h(
    "ul",
    { class: "alarms" },
    alarms
      .map((alarm) =>
        h(
          "li",
          {},
          h("b", {}, alarm.title),
          ` ${alarm.detail}`,
          h("small", {}, `version ${alarm.version}, ${clock(alarm.t)}`),
        ),
      ),
  );
}

// Links as a list of large targets, each with its share as a bar.
export function linkList(links, other, none) {
  if (!links.length) return h("p", { class: "quiet" }, none);
  return h(
    "ul",
    { class: "links" },
    links.map((one) =>
      h(
        "li",
        {},
        h(
          "a",
          { href: link("link", one.from, one.to, one.relation) },
          h("span", { class: `stroke ${one.relation}` }),
          h("b", {}, other(one)),
          h(
            "span",
            { class: "quiet" },
            one.from === other(one) ? `to ${one.to}` : `from ${one.from}`,
          ),
          h("span", { class: "bar", "aria-hidden": "true" }, bar(one.probability)),
          h("span", { class: "number" }, percent(one.probability)),
          h("span", { class: "number" }, one.transit.q50 < 0 ? "overlap" : seconds(one.transit.q50)),
        ),
      ),
    ),
  );
}

function bar(share) {
  const filled = h("i", {});
  filled.style.width = `${Math.round(100 * Math.min(1, share))}%`;
  return filled;
}

function zoneTable(story) {
  if (!story.zones.length) return h("p", { class: "quiet" }, "No zone has been learned yet.");
  return h(
    "table",
    {},
    h(
      "thead",
      {},
      h(
        "tr",
        {},
        ["Zone", "In", "Out", "From outside"].map((name, k) =>
          h("th", { scope: "col", class: k ? "number" : null }, name),
        ),
      ),
    ),
    h(
      "tbody",
      {},
      story.zones.map((zone) =>
        h(
          "tr",
          {},
          h("th", { scope: "row" }, zone.id),
          h("td", { class: "number" }, count(zone.entries)),
          h("td", { class: "number" }, count(zone.exits)),
          h(
            "td",
            { class: "number", title: "Arrivals that no departure elsewhere explains, per hour" },
            zone.arrival_rate === null ? "–" : `${count(3600 * zone.arrival_rate)} / h`,
          ),
        ),
      ),
    ),
  );
}

function showStatus(element, row, since) {
  if (!row) return fill(element);
  return fill(
    element,
    h("span", { class: `pill ${row.look}` }, row.state),
    since,
    row.reason ? h("span", { class: "reason" }, row.reason) : null,
  );
}

// The picture (or a plain frame) with zones, passages and live events drawn on it.
class Scene {
  constructor(story, picture) {
    this.pulse = h("span", { class: "quiet" }, "waiting for events");
    this.element = h("figure", { class: "scene" });
    this.size = FRAME;
    this.events = [];
    this.picture = null; // once it is there
    this.update(story, picture);
  }

  // Draw what is known now; the events that have been seen stay.
  update(story, picture) {
    this.story = story;
    this.#draw();
    if (!story.picture || !picture || this.picture) return this;
    const image = new Image();
    image.addEventListener("load", () => {
      this.size = [image.naturalWidth, image.naturalHeight];
      this.picture = picture;
      this.events = []; // which were drawn on the frame
      this.#draw();
    });
    image.src = picture;
    return this;
  }

  // An entry or exit that has just been seen.
  add(event) {
    this.pulse.textContent = `${event.kind === "entry" ? "entry" : "exit"}, ${clock(event.t)}`;
    if (event.x === undefined || event.x === null) return;
    this.#mark(event.kind, event.x, event.y);
  }

  // An exit as its prediction tells it, for those who may not read the events.
  left(prediction) {
    this.pulse.textContent = `left at ${prediction.zone ?? prediction.camera}: ${prediction.words}`;
    this.zones.get(prediction.zone)?.classList.add("active");
    setTimeout(() => this.zones.get(prediction.zone)?.classList.remove("active"), 1500);
  }

  // Somebody who has just left another view may be in this one.
  sees({ camera, now }) {
    const seen = now.find((one) => one.camera === this.story.id);
    if (seen) this.pulse.textContent = `who left ${camera} is in view now (${percent(seen.probability)})`;
  }

  #mark(kind, x, y) {
    const [width, height] = this.size;
    const r = 5 * this.unit;
    const element =
      kind === "entry"
        ? s("circle", { class: "event entry", cx: x * width, cy: y * height, r })
        : s("rect", { class: "event exit", x: x * width - r, y: y * height - r, width: 2 * r, height: 2 * r });
    this.marks.append(element);
    this.events.push(element);
    if (this.events.length > EVENTS_SHOWN) this.events.shift().remove();
  }

  #draw() {
    const [width, height] = this.size;
    const { picture } = this;
    this.element.classList.toggle("pictured", Boolean(picture));
    this.marks = s("g", {}, this.events);
    this.zones = new Map();
    const placed = this.story.zones.filter((zone) => zone.x !== undefined && zone.x !== null);
    const [mx, my] = margins(placed);
    const seen = [this.element.clientWidth || PIXELS[0], PIXELS[1]];
    this.unit = Math.max(((1 + 2 * mx) * width) / seen[0], ((1 + 2 * my) * height) / seen[1]); // a pixel
    const busiestFirst = [...placed].sort((a, b) => b.entries + b.exits - a.entries - a.exits);
    const taken = new Taken();
    const svg = s(
      "svg",
      {
        viewBox: [-mx * width, -my * height, (1 + 2 * mx) * width, (1 + 2 * my) * height].join(" "),
        role: "img",
        "aria-label": `View of ${this.story.id} with ${plural(placed.length, "learned zone")}`,
      },
      arrowHead(width),
      picture ? s("image", { href: picture, width, height }) : grid(width, height),
      picture ? s("rect", { class: "shade", width, height }) : null,
      this.#passages(placed),
      busiestFirst.map((zone) => this.#zone(zone, taken)),
      this.marks,
    );
    svg.style.setProperty("--unit", `${this.unit}px`);
    fill(
      this.element,
      svg,
      placed.length < this.story.zones.length
        ? h("figcaption", {}, "This camera's events have no positions, so it has a single zone.")
        : null,
    );
  }

  // A zone with its number and its counts, as far as these fit beside those of zones before.
  #zone(zone, taken) {
    const [width, height] = this.size;
    const { major, minor, turn } = ellipse(zone.cov, width, height);
    const [x, y] = [zone.x * width, zone.y * height];
    const { unit } = this;
    const within = (value, from, to) => Math.min(to, Math.max(from, value));
    const [come, go] = [`${count(zone.entries)} in`, `${count(zone.exits)} out`];
    const half = COUNT_UNITS * (come.length + go.length + 1) * unit;
    const inside = within(x, half, width - half);
    const number = within(x, NUMBER_UNITS * unit, width - NUMBER_UNITS * unit);
    const line = within(y, NUMBER_UNITS * unit, height - NUMBER_UNITS * unit) + 5 * unit;
    const below = line + (line + 16 * unit < height ? 12 * unit : -16 * unit);
    const free = (middle, half, base, tall) => {
      const box = [middle - half, base - tall, middle + half, base].map((value) => value / unit);
      if (!taken.free(...box)) return false;
      taken.add(...box);
      return true;
    };
    const name = zone.id.slice(zone.id.lastIndexOf("/") + 1);
    const numbered = free(number, NUMBER_UNITS * unit, line, 11 * unit);
    const counted = numbered && free(inside, half, below, 10 * unit);
    const counts = counted && s(
      "text",
      { class: "counts", x: inside, y: below, "text-anchor": "middle" },
      s("tspan", { class: "in" }, come),
      s("tspan", { class: "out", dx: 5 * unit }, go),
    );
    const element = s(
      "g",
      { class: "zone" },
      s("ellipse", { rx: major, ry: minor, transform: `translate(${x} ${y}) rotate(${turn})` }),
      numbered && s("text", { x: number, y: line, "text-anchor": "middle" }, name),
      counts,
      s("title", {}, `${zone.id}: ${count(zone.entries)} in, ${count(zone.exits)} out`),
    );
    this.zones.set(zone.id, element);
    return element;
  }

  #passages(placed) {
    const [width, height] = this.size;
    const at = new Map(placed.map((zone) => [zone.id, [zone.x * width, zone.y * height]]));
    return this.story.links
      .filter(
        (one) =>
          one.relation === "visible" &&
          one.from !== one.to &&
          one.probability >= PASSAGE_SHARE_MIN &&
          at.has(one.from) &&
          at.has(one.to),
      )
      .map((one) => {
        const [ax, ay] = at.get(one.from);
        const [bx, by] = at.get(one.to);
        const [mx, my] = [(ax + bx) / 2 - 0.16 * (by - ay), (ay + by) / 2 + 0.16 * (bx - ax)];
        const along = 1 - Math.min(0.4, (HEAD_BEFORE * width) / (Math.hypot(bx - ax, by - ay) || 1));
        const d = `M${ax} ${ay}Q${partOfCurve([ax, ay], [mx, my], [bx, by], along).flat().join(" ")}`;
        const path = s(
          "path",
          { class: "passage", d, "marker-end": "url(#head)" },
          s("title", {}, `${one.from} → ${one.to}: ${percent(one.probability)}, ${seconds(one.transit.q50)}`),
        );
        path.style.setProperty("--share", one.probability.toFixed(2));
        return path;
      });
  }
}

// Half axes in pixels and the turn in degrees of `SPREAD` standard deviations of a covariance in picture fractions.
function ellipse(cov, width, height) {
  const [a, b, d] = [cov[0][0] * width * width, cov[0][1] * width * height, cov[1][1] * height * height];
  const middle = (a + d) / 2;
  const apart = Math.hypot((a - d) / 2, b);
  return {
    major: SPREAD * Math.sqrt(middle + apart),
    minor: SPREAD * Math.sqrt(Math.max(middle - apart, 0)),
    turn: (0.5 * Math.atan2(2 * b, a - d) * 180) / Math.PI,
  };
}

// How far zones reach beyond the picture, of its width and of its height.
function margins(zones) {
  return [0, 1].map((axis) => {
    const beyond = zones.map((zone) => {
      const at = axis ? zone.y : zone.x;
      return SPREAD * Math.sqrt(zone.cov[axis][axis]) - Math.min(at, 1 - at);
    });
    return Math.min(MARGINS[1], Math.max(MARGINS[0], ...beyond));
  });
}

// The middle and the end point of the first part, up to `along`, of a curve with these three.
function partOfCurve(start, middle, end, along) {
  const between = (one, other) => one.map((value, k) => value + along * (other[k] - value));
  const first = between(start, middle);
  return [first, between(first, between(middle, end))];
}

function grid(width, height) {
  const lines = [];
  for (let k = 1; k < 8; k += 1) lines.push(s("line", { x1: (k * width) / 8, x2: (k * width) / 8, y1: 0, y2: height }));
  for (let k = 1; k < 6; k += 1)
    lines.push(s("line", { x1: 0, x2: width, y1: (k * height) / 6, y2: (k * height) / 6 }));
  return s("g", { class: "frame" }, s("rect", { width, height }), lines);
}

function arrowHead(width) {
  return s(
    "defs",
    {},
    s(
      "marker",
      {
        id: "head",
        viewBox: "0 0 8 8",
        refX: 7,
        refY: 4,
        markerWidth: width / 70,
        markerHeight: width / 70,
        markerUnits: "userSpaceOnUse",
        orient: "auto",
      },
      s("path", { class: "head", d: "M0 0 8 4 0 8Z" }),
    ),
  );
}

function clockText(story) {
  if (story.clock_offset_sd === null || story.clock_offset_sd === undefined) return "unknown";
  if (Math.abs(story.clock_offset) < 2 * story.clock_offset_sd) return `correct, ± ${seconds(story.clock_offset_sd)}`;
  return `${seconds(Math.abs(story.clock_offset))} ${story.clock_offset > 0 ? "ahead" : "behind"}`;
}

function key(kind, text) {
  return h("span", {}, h("i", { class: `swatch ${kind}` }), text);
}

function camera(zone) {
  return zone.slice(0, zone.lastIndexOf("/"));
}

// A figure; what it means unfolds below its name, as neither a finger nor a key can point at a name.
export function fact(name, value, meaning = null) {
  const told = meaning === null ? name : h("details", {}, h("summary", {}, name), h("span", {}, meaning));
  return h("div", {}, h("dt", {}, told), h("dd", {}, value));
}
