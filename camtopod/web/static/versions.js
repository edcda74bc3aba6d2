// The versions as a time line, the daemon's own score over time, and what each version changed.

import { alarmList, fact } from "./camera.js";
import { axisX, axisY, points, scale, ticks } from "./chart.js";
import { fill, h, more, s } from "./dom.js";
import { link } from "./place.js";
import { Away } from "./source.js";
import { axisTime, clock, count, percent, plural } from "./words.js";

const ROWS = 40;
const NARROW = matchMedia("(max-width: 720px)");
const HEIGHT = 200;
const HEIGHT_BARE = 56; // of a time line without a curve
const WITHOUT_CURVE =
  "Each mark is a version. Predictions are scored with the help of later versions; a curve needs two scored versions.";
const EDGE = { left: 44, right: 14, top: 16, bottom: 26 };

export class Versions {
  #all = []; // summaries, oldest first
  #open = false;
  #chosen = null; // the version that the address names; without one the newest is shown
  #rows = ROWS;

  constructor(app) {
    this.app = app;
    this.head = h("div", {});
    this.chart = h("div", { class: "card" });
    this.list = h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Versions" });
    this.changes = h("div", { class: "card", role: "status" });
    this.alarms = h("div", { class: "card" });
    this.element = h(
      "section",
      { class: "page" },
      h("h1", {}, "Versions"),
      this.head,
      h("div", { class: "columns" }, h("div", {}, this.chart, this.changes), h("div", {}, this.list, this.alarms)),
    );
  }

  // A new version has come.
  async update() {
    if (this.#open) await this.#refresh();
  }

  // The view is shown, with the changes of the version that is named.
  async shown(version) {
    this.#open = true;
    this.#chosen = version ?? null;
    await this.#refresh();
  }

  hidden() {
    this.#open = false;
  }

  async #refresh() {
    try {
      this.#all = await this.app.source.versions();
    } catch (error) {
      if (!(error instanceof Away)) throw error;
      if (!this.#all.length) fill(this.head, h("p", { class: "quiet" }, error.message));
      return;
    }
    this.#draw();
  }

  #draw() {
    const all = this.#all;
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
        newest.longest
          ? fact(
              "Longest way looked for",
              `${newest.longest.toFixed(0)} s`,
              "Found from the events. Who is not seen again within this time is said to leave",
            )
          : null,
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
    fill(this.changes, changesOf(all.find((one) => String(one.version) === this.#chosen) ?? newest));
    const alarms = this.app.map?.alarms ?? [];
    fill(
      this.alarms,
      h("h2", {}, "Alarms"),
      alarms.length ? alarmList(alarms.slice(0, 30)) : h("p", { class: "quiet" }, "None."),
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
                  { href: link("versions", one.version), title: "What changed with it" },
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
}

// What a version changed, in a table-like list.
function changesOf({ version, since, changes, changes_count: all }) {
  if (since === null)
    return [h("h2", {}, "What changed"), h("p", { class: "quiet" }, `Version ${version} is the first one known here.`)];
  return [
    h("h2", {}, `What changed from version ${since} to ${version}`),
    changes.length
      ? h("ul", { class: "changes" }, changes.map(changed))
      : h("p", { class: "quiet" }, "No camera, pair, link or zone came or went."),
    all > changes.length ? h("p", { class: "quiet" }, `and ${count(all - changes.length)} more`) : null,
  ];
}

function changed({ kind, subject, before, now }) {
  const [look, sign, title] =
    before === null ? ["new", "+", "appeared"] : now === null ? ["gone", "−", "disappeared"] : ["other", "~", "changed"];
  const text = before && now ? `${before} → ${now}` : now || before;
  return h(
    "li",
    { class: look },
    h("span", { class: "sign", title }, sign),
    h("span", { class: "kind" }, kind),
    h("span", {}, subjectOf(kind, subject, now !== null), text ? h("small", {}, text) : null),
  );
}

// What a change is about, as a link to its page where there is one.
function subjectOf(kind, parts, exists) {
  const text = kind === "link" ? `${parts[0]} → ${parts[1]}` : parts.join(" – ");
  if (!exists) return h("b", {}, text);
  const href = kind === "zone" ? link("camera", parts[0].split("/")[0]) : link(kind, ...parts);
  return h("a", { href }, text);
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
      { viewBox: `0 0 ${width} ${height}`, role: "group", "aria-label": label },
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
    { href: link("versions", one.version), tabindex: -1 },
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
