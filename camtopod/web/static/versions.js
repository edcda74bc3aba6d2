// The versions as a time line, the daemon's own score over time, and what changed between any two.

import { alarmList, fact } from "./camera.js";
import { axisX, axisY, points, scale, ticks } from "./chart.js";
import { fill, h, more, s } from "./dom.js";
import { go, link } from "./place.js";
import { Away, NotThere } from "./source.js";
import { axisTime, clock, count, percent, plural } from "./words.js";

const ASKED_MAX = 60; // older versions that are asked of the daemon while this is open
const ROWS = 40;
const CHANGES_SHOWN = 300;
const SIGNS = { "+": ["new", "appeared"], "-": ["gone", "disappeared"], "~": ["other", "changed"] };
const NARROW = matchMedia("(max-width: 720px)");
const HEIGHT = 200;
const HEIGHT_BARE = 56; // of a time line without a curve
const WITHOUT_CURVE =
  "Each mark is a version. Predictions are scored with the help of later versions; a curve needs two scored versions.";
const EDGE = { left: 44, right: 14, top: 16, bottom: 26 };

export class Versions {
  #known = new Map(); // version -> summary
  #open = false;
  #asking = false;
  #compared = "";
  #named = []; // the versions that the address names, if any
  #rows = ROWS;

  constructor(app) {
    this.app = app;
    this.head = h("div", {});
    this.chart = h("div", { class: "card" });
    this.list = h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Versions" });
    this.compare = h("div", { class: "card" });
    this.alarms = h("div", { class: "card" });
    this.element = h(
      "section",
      { class: "page" },
      h("h1", {}, "Versions"),
      this.head,
      h("div", { class: "columns" }, h("div", {}, this.chart, this.compare), h("div", {}, this.list, this.alarms)),
    );
  }

  // A new version has come.
  async update(map) {
    if (this.#known.size && map && this.#known.values().next().value.epoch !== map.epoch) this.#known.clear();
    if (this.#open) await (this.#known.size ? this.#refresh() : this.shown(...this.#named));
  }

  // The view is shown, comparing two versions if they are named.
  async shown(old, now) {
    this.#open = true;
    this.#named = [old, now];
    await this.#refresh();
    const [, last] = this.#ends();
    if (last === undefined) return;
    if (last === 1) {
      fill(this.compare, h("h2", {}, "What changed"), h("p", { class: "quiet" }, "There is one version so far."));
      return;
    }
    const versions = [numbered(old) ?? Math.max(1, last - 1), numbered(now) ?? last];
    await this.#compareThem(Math.min(...versions), Math.max(...versions));
    if (this.app.source.live) await this.#askForOlder();
  }

  hidden() {
    this.#open = false;
  }

  #ends() {
    const versions = [...this.#known.keys()].sort((a, b) => a - b);
    return [versions[0], versions.at(-1)];
  }

  async #refresh() {
    try {
      for (const one of await this.app.source.versions()) this.#known.set(one.version, one);
    } catch (error) {
      if (!(error instanceof Away)) throw error;
      if (!this.#known.size) fill(this.head, h("p", { class: "quiet" }, error.message));
      return;
    }
    this.#draw();
  }

  // Newest first, one at a time, until the daemon keeps no older one.
  async #askForOlder() {
    if (this.#asking) return;
    this.#asking = true;
    try {
      for (
        let asked = 0, version = this.#ends()[1] - 1;
        this.#open && version >= 1 && asked < ASKED_MAX;
        version -= 1
      ) {
        if (this.#known.has(version)) continue;
        asked += 1;
        const found = await this.app.source.version(version);
        this.#known.set(found.version, found);
        this.#draw();
      }
    } catch (error) {
      if (!(error instanceof NotThere || error instanceof Away)) throw error;
    } finally {
      this.#asking = false;
    }
  }

  #draw() {
    const all = [...this.#known.values()].sort((a, b) => a.version - b.version);
    const newest = all.at(-1);
    if (!newest) return fill(this.head, h("p", { class: "quiet" }, "No version yet."));
    const score = newest.score;
    fill(
      this.head,
      h(
        "dl",
        { class: "figures wide" },
        fact("Newest version", count(newest.version)),
        fact("As of", clock(newest.as_of)),
        fact("Events learned", count(newest.events)),
        fact("Related pairs", count(newest.pairs)),
        score
          ? fact(
              "Next camera correct",
              `${percent(score.top1)} (usual: ${percent(score.baseline_top1)})`,
              "Share of predictions whose most likely camera was correct, judged with the help of later versions. Usual: always naming the most frequent next camera",
            )
          : null,
        score
          ? fact(
              "Log loss",
              `${score.log_loss.toFixed(2)} (usual: ${score.baseline_log_loss.toFixed(2)})`,
              "Mean of −ln(probability of the outcome); lower is better",
            )
          : null,
      ),
    );
    fill(this.chart, h("h2", {}, "Versions and score"), timeLine(all));
    fill(
      this.list,
      this.#table(all),
      all.length > this.#rows &&
        more(`Show ${count(Math.min(ROWS, all.length - this.#rows))} more`, () => {
          this.#rows += ROWS;
          this.#draw();
        }),
    );
    const alarms = all.flatMap((one) => one.alarms);
    fill(
      this.alarms,
      h("h2", {}, "Alarms"),
      alarms.length ? alarmList(alarms.slice(-30)) : h("p", { class: "quiet" }, "None in the versions listed."),
    );
    return undefined;
  }

  #table(all) {
    return h(
      "table",
      {},
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          ["Version", "As of", "Events", "Links", "Pairs", "Alarms"].map((name, k) =>
            h("th", { scope: "col", class: k > 1 ? "number" : null }, name),
          ),
        ),
      ),
      h(
        "tbody",
        {},
        [...all]
          .reverse()
          .slice(0, this.#rows)
          .map((one) =>
            h(
              "tr",
              {},
              h(
                "th",
                { scope: "row" },
                h(
                  "a",
                  { href: link("versions", Math.max(1, one.version - 1), one.version), title: "What changed with it" },
                  one.version,
                ),
              ),
              h("td", { class: "nowrap" }, clock(one.as_of)),
              h("td", { class: "number" }, count(one.events)),
              h("td", { class: "number" }, count(one.links)),
              h("td", { class: "number" }, count(one.pairs)),
              h(
                "td",
                { class: "number" },
                one.alarms.length
                  ? h("span", { class: "pill bad", title: plural(one.alarms.length, "alarm") }, one.alarms.length)
                  : null,
              ),
            ),
          ),
      ),
    );
  }

  async #compareThem(old, now) {
    const asked = (this.#compared = `${old} ${now}`);
    const [, last] = this.#ends();
    const field = (value, name) => h("input", { type: "number", min: 1, max: last, value, "aria-label": name });
    const [from, to] = [field(old, "Older version"), field(now, "Newer version")];
    const form = h(
      "form",
      {
        class: "tools",
        on: {
          submit: (event) => {
            event.preventDefault();
            go("versions", from.value, to.value);
          },
        },
      },
      "from ",
      from,
      " to ",
      to,
      h("button", { type: "submit" }, "Compare"),
    );
    const result = h("div", { role: "status" }, h("p", { class: "quiet" }, "Comparing …"));
    fill(this.compare, h("h2", {}, "What changed"), form, result);
    try {
      const found = await this.app.source.changes(old, now);
      if (asked === this.#compared) fill(result, changeList(found));
    } catch (error) {
      if (!(error instanceof NotThere || error instanceof Away)) throw error;
      fill(result, h("p", { class: "quiet" }, error.message));
    }
  }
}

// The version that a part of the address names, if it can be one.
function numbered(text) {
  const number = Number(text);
  return Number.isSafeInteger(number) && number > 0 ? number : null;
}

function changeList(changes) {
  if (!changes.length)
    return h("p", { class: "quiet" }, "No notable change: figures differ by less than their uncertainty.");
  return [
    h(
      "p",
      { class: "quiet" },
      Object.entries(SIGNS)
        .map(([sign, [, verb]]) => [changes.filter((one) => one.sign === sign).length, verb])
        .filter(([n]) => n)
        .map(([n, verb]) => `${count(n)} ${verb}`)
        .join(", "),
    ),
    h(
      "ul",
      { class: "changes" },
      changes
        .slice(0, CHANGES_SHOWN)
        .map((one) =>
          h(
            "li",
            { class: SIGNS[one.sign][0] },
            h("span", { class: "sign", title: SIGNS[one.sign][1] }, one.sign === "-" ? "−" : one.sign),
            h("span", { class: "kind" }, one.kind),
            h("span", {}, subject(one), h("small", {}, one.text)),
          ),
        ),
    ),
    changes.length > CHANGES_SHOWN
      ? h("p", { class: "quiet" }, `and ${count(changes.length - CHANGES_SHOWN)} more`)
      : null,
  ];
}

// What a change is about, as a link to its page where there is one.
function subject({ kind, sign, subject: parts }) {
  const text = kind === "link" ? `${parts[0]} → ${parts[1]}` : parts.join(" – ");
  if (sign === "-") return h("b", {}, text);
  const camera = parts[0].split("/")[0];
  return h(
    "a",
    {
      href:
        kind === "link" ? link("link", ...parts) : kind === "pair" ? link("pair", ...parts) : link("camera", camera),
    },
    text,
  );
}

// All versions along the time, those that have a score at the height of it.
function timeLine(all) {
  const width = NARROW.matches ? 360 : 680;
  const scored = all.filter((one) => one.score);
  const curved = scored.length > 1; // one has no curve
  const height = curved ? HEIGHT : HEIGHT_BARE;
  const floor = height - EDGE.bottom;
  const range = all.at(-1).as_of - all[0].as_of;
  const x = scale(all[0].as_of, all.at(-1).as_of, range ? EDGE.left : width / 2, width - EDGE.right);
  const y = scale(0, 1, floor, EDGE.top);
  const along = (value) => points(scored.map((one) => [x(one.as_of), y(value(one.score))]));
  const off = (one) => Math.abs(one.as_of - all[0].as_of - range / 2);
  const middle = all.reduce((best, one) => (off(one) < off(best) ? one : best));
  const named = [all[0], ...(off(middle) < range / 4 ? [middle] : []), all.at(-1)]; // as far apart as their texts
  const label = curved
    ? `Most likely camera correct in ${percent(scored.at(-1).score.top1)} of the newest predictions scored`
    : `${plural(all.length, "version")} by time`;
  return h(
    "figure",
    { class: "chart" },
    s(
      "svg",
      { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label },
      axisY(y, curved ? ticks(0, 1, 4) : [0], EDGE.left, width - EDGE.right, (v) => (curved ? `${100 * v} %` : "")),
      axisX(x, [...new Set(named.map((one) => one.as_of))], floor + 2, floor, (t) => axisTime(t, range)),
      curved
        ? [
            s("path", { class: "curve usual", d: along((score) => score.baseline_top1) }),
            s("path", { class: "curve third", d: along((score) => score.top3) }),
            s("path", { class: "curve", d: along((score) => score.top1) }),
          ]
        : null,
      all.map((one) => mark(one, x(one.as_of), curved && one.score ? y(one.score.top1) : floor)),
    ),
    h("figcaption", {}, curved ? curves() : h("p", {}, WITHOUT_CURVE)),
  );
}

// A version on the time line, which opens what changed with it.
function mark(one, cx, cy) {
  const alarmed = one.alarms.length > 0;
  const said = one.score
    ? `${percent(one.score.top1)}, log loss ${one.score.log_loss.toFixed(2)}, ${count(one.score.exits)} exits`
    : "not scored yet";
  return s(
    "a",
    { href: link("versions", Math.max(1, one.version - 1), one.version), tabindex: -1 },
    s("circle", { class: `mark${alarmed ? " alarm" : ""}${one.score ? "" : " unscored"}`, cx, cy, r: alarmed ? 5 : 3.5 }),
    s("title", {}, `version ${one.version}, ${clock(one.as_of)}: ${said}`),
  );
}

function curves() {
  return h(
    "div",
    { class: "legend" },
    [
      ["curve", "most likely camera correct"],
      ["third", "among the three most likely"],
      ["usual", "always naming the most frequent next camera"],
    ].map(([kind, text]) => h("span", {}, h("i", { class: `swatch ${kind}` }), text)),
  );
}
