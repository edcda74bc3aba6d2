// The versions as a time line, the daemon's own score over time, and what changed between any two.

import { alarmList, fact } from "./camera.js";
import { axisX, axisY, points, scale, ticks } from "./chart.js";
import { fill, h, s } from "./dom.js";
import { go, link } from "./place.js";
import { Away, NotThere } from "./source.js";
import { axisTime, clock, count, percent, plural } from "./words.js";

const ASKED_MAX = 60; // older versions that are asked of the daemon while this is open
const LISTED = 40;
const CHANGES_SHOWN = 300;
const SIGNS = { "+": ["new", "appeared"], "-": ["gone", "disappeared"], "~": ["other", "changed"] };
const NARROW = matchMedia("(max-width: 720px)");
const HEIGHT = 200;
const EDGE = { left: 44, right: 14, top: 16, bottom: 26 };

export class Versions {
  #known = new Map(); // version -> summary
  #open = false;
  #asking = false;
  #compared = "";
  #named = []; // the versions that the address names, if any

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
    const versions = [Number(old) || Math.max(1, last - 1), Number(now) || last];
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
              "Next camera right",
              `${percent(score.top1)} (usual: ${percent(score.baseline_top1)})`,
              "How often its first guess was right, marked by what later versions know; beside always naming the most frequent next camera",
            )
          : null,
        score
          ? fact(
              "Log loss",
              `${score.log_loss.toFixed(2)} (usual: ${score.baseline_log_loss.toFixed(2)})`,
              "Mean of −ln(probability of what happened); less is better",
            )
          : null,
      ),
    );
    fill(this.chart, h("h2", {}, "Its own score"), scoreChart(all));
    fill(this.list, this.#table(all));
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
          .slice(0, LISTED)
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

function changeList(changes) {
  if (!changes.length)
    return h("p", { class: "quiet" }, "Nothing that shows: figures moved by less than their own uncertainty.");
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

function scoreChart(all) {
  const width = NARROW.matches ? 360 : 680;
  const scored = all.filter((one) => one.score);
  if (scored.length < 2)
    return h(
      "p",
      { class: "quiet" },
      "The daemon marks its predictions by what later versions know; a curve needs two scored versions.",
    );
  const x = scale(scored[0].as_of, scored.at(-1).as_of, EDGE.left, width - EDGE.right);
  const y = scale(0, 1, HEIGHT - EDGE.bottom, EDGE.top);
  const along = (value) => points(scored.map((one) => [x(one.as_of), y(value(one.score))]));
  const range = scored.at(-1).as_of - scored[0].as_of;
  const marks = [scored[0], scored[Math.floor(scored.length / 2)], scored.at(-1)];
  return h(
    "figure",
    { class: "chart" },
    s(
      "svg",
      {
        viewBox: `0 0 ${width} ${HEIGHT}`,
        role: "img",
        "aria-label": `First guess right in ${percent(scored.at(-1).score.top1)} of the newest predictions scored`,
      },
      axisY(y, ticks(0, 1, 4), EDGE.left, width - EDGE.right, (value) => `${100 * value} %`),
      axisX(x, [...new Set(marks.map((one) => one.as_of))], HEIGHT - EDGE.bottom + 2, HEIGHT - EDGE.bottom, (t) =>
        axisTime(t, range),
      ),
      s("path", { class: "curve usual", d: along((score) => score.baseline_top1) }),
      s("path", { class: "curve third", d: along((score) => score.top3) }),
      s("path", { class: "curve", d: along((score) => score.top1) }),
      scored.map((one) =>
        s(
          "a",
          { href: link("versions", Math.max(1, one.version - 1), one.version), tabindex: -1 },
          s("circle", {
            class: one.alarms.length ? "mark alarm" : "mark",
            cx: x(one.as_of),
            cy: y(one.score.top1),
            r: one.alarms.length ? 5 : 3.5,
          }),
          s(
            "title",
            {},
            `version ${one.version}: ${percent(one.score.top1)}, log loss ${one.score.log_loss.toFixed(2)}, ${count(one.score.exits)} exits`,
          ),
        ),
      ),
    ),
    h(
      "figcaption",
      { class: "legend" },
      h("span", {}, h("i", { class: "swatch curve" }), "first guess right"),
      h("span", {}, h("i", { class: "swatch third" }), "among the first three"),
      h("span", {}, h("i", { class: "swatch usual" }), "always naming the usual next camera"),
    ),
  );
}
