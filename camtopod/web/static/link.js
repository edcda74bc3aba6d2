// A pair of cameras, and one link: its transit times as a chart, the tests' figures, and why it is believed.

import { fact, linkList } from "./camera.js";
import { axisX, axisY, points, scale, ticks } from "./chart.js";
import { h, s } from "./dom.js";
import { link } from "./place.js";
import { NotThere } from "./source.js";
import { count, howMany, percent, scientific, seconds, span, transit } from "./words.js";

const WIDTH = 420;
const HEIGHT = 250;
const EDGE = { left: 40, right: 12, top: 14, bottom: 58 };
const RUG = { top: 12, height: 9 };
const BEYOND = 2.5; // how far around the middle 80 % the chart goes, in widths of it
const KINDS = {
  overlapped: "Overlapping views",
  unseen_path: "Unseen path",
  unseen: "Unseen path",
  visible: "Within one view",
};

// What the panel shows of the cameras `a` and `b`.
export async function pairPanel(app, a, b) {
  const story = await app.source.pair(a, b);
  const [one, other] = story.cameras;
  const towards = (to) => story.links.filter((each) => each.to.startsWith(`${to}/`));
  return {
    kind: KINDS[story.relation] ?? "Likely link",
    title: `${one} – ${other}`,
    chosen: story.cameras,
    body: [
      story.provisional
        ? h("p", { class: "provisional-note" }, h("b", {}, story.relation ? "Provisional: " : "Likely: "), story.provisional)
        : null,
      h(
        "ul",
        { class: "why" },
        story.why.map((sentence) => h("li", {}, sentence)),
      ),
      [
        [one, other],
        [other, one],
      ].map(([from, to]) => [
        h("h3", {}, `${from} → ${to}`),
        underWay(app, from, to),
        linkList(towards(to), (each) => each.to, "No link is published in this direction."),
      ]),
      story.weak.length
        ? [
            h("h3", {}, "Weak evidence"),
            h("p", { class: "quiet" }, "Not published; used for predictions only."),
            linkList(story.weak.slice(0, 8), (each) => each.to, ""),
          ]
        : null,
    ],
  };
}

// How many objects are between the cameras now.
function underWay(app, from, to) {
  const told = app.between?.pairs.find((one) => one.from === from && one.to === to);
  return told ? h("p", { class: "quiet" }, `On the way now: ${howMany(told)} in eight of ten cases.`) : null;
}

// What the panel shows of the link between two zones.
export async function linkPanel(app, from, to, relation) {
  const story = await app.source.link(from, to, relation ?? (await onlyRelation(app, from, to)));
  const t = story.transit;
  const inOneView = story.relation === "visible"; // which is seen, not inferred
  return {
    kind: story.weak ? "Weak evidence" : KINDS[story.relation],
    title: `${story.from} → ${story.to}`,
    chosen: [...new Set(story.cameras)],
    body: [
      h(
        "p",
        { class: "lead" },
        h("b", {}, percent(story.probability)),
        ` of the objects that ${inOneView ? "enter" : "leave"} at ${story.from}`,
        t.q50 < 0
          ? [` are in both views: they appear at ${story.to} `, h("b", {}, transit(t.q50))]
          : [", in ", h("b", {}, seconds(t.q50))],
      ),
      chart(story),
      h("h3", {}, story.weak ? "Evidence so far" : "Evidence"),
      h(
        "ul",
        { class: "why" },
        story.why.map((sentence) => h("li", {}, sentence)),
      ),
      h("h3", {}, "Figures"),
      h(
        "dl",
        { class: "figures" },
        fact(
          "Transitions",
          count(story.transitions),
          "Expected number in the window that was learned from",
        ),
        inOneView ? null : fact("Departures", count(story.departures)),
        fact("Most frequent time", transit(t.mode), "The mode, which the thesis takes as the weight of the edge"),
        fact("Median", t.q50_sd ? `${transit(t.q50)} ± ${seconds(t.q50_sd)}` : transit(t.q50)),
        fact("Mean, sd", `${seconds(t.mean)}, ${seconds(t.sd)}`),
        fact("Middle 80 %", span(t.q10, t.q90)),
        inOneView
          ? null
          : [
              fact("q value", scientific(story.q_value), "False discovery rate at which the link is published"),
              fact(
                "Var(d)",
                scientific(story.mahalanobis_variance),
                "The thesis's Mahalanobis test: zones are linked up to 1. It used samples drawn when this version was learned; those below the chart are drawn anew from the fitted curve",
              ),
            ],
        inOneView
          ? null
          : fact(
              "Background",
              story.background === null ? "–" : `${scientific(story.background)} / s`,
              "Unrelated arrivals after all departures together, per second of lag",
            ),
      ),
      new Set(story.cameras).size === 2
        ? h(
            "p",
            {},
            h("a", { href: link("pair", ...story.cameras) }, `All links between ${story.cameras.join(" and ")}`),
          )
        : null,
    ],
  };
}

// Of the link between two zones, for an address that does not say it.
async function onlyRelation(app, from, to) {
  const [a, b] = [from, to ?? ""].map((zone) => zone.split("/")[0]);
  const { links, weak = [] } = a === b ? await app.source.camera(a) : await app.source.pair(a, b);
  const found = [...links, ...weak].filter((each) => each.from === from && each.to === to);
  if (found.length === 1) return found[0].relation;
  const which = found.map((each) => each.relation).join(", ");
  throw new NotThere(
    found.length ? `There are several links from ${from} to ${to}: ${which}.` : `No link leads from ${from} to ${to ?? "?"}.`,
  );
}

function chart(story) {
  if (!story.chart) return h("p", { class: "quiet" }, `No histogram is kept of ${story.weak ? "weak evidence" : "this link"}.`);
  const t = story.transit;
  const { counts, curve, samples } = story.chart;
  const edge = (k) => story.chart.delay + story.chart.scale * Math.sinh(story.chart.step * (story.chart.first + k));
  const bins = counts.map((n, k) => {
    const [left, right] = [edge(k), edge(k + 1)];
    return { left, right, n, bar: n / (right - left), curve: curve[k] / (right - left) };
  });
  const reach = BEYOND * Math.max(t.q90 - t.q10, 0.5);
  const shown = bins.filter((bin) => bin.right > t.q10 - reach && bin.left < t.q90 + reach);
  const beyond = story.transitions - shown.reduce((sum, bin) => sum + bin.n, 0);
  const [low, high] = [shown[0].left, shown.at(-1).right];
  const peak = Math.max(...shown.map((bin) => Math.max(bin.bar, bin.curve)));
  const top = Math.max(peak, Math.min(story.background ?? 0, 2 * peak)) * 1.08;
  const floor = HEIGHT - EDGE.bottom;
  const x = scale(low, high, EDGE.left, WIDTH - EDGE.right);
  const y = scale(0, top, floor, EDGE.top);
  const line = shown.map((bin) => [x((bin.left + bin.right) / 2), y(bin.curve)]);
  return h(
    "figure",
    { class: "chart" },
    s(
      "svg",
      {
        viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
        role: "img",
        "aria-label": `Transit times: most frequent ${seconds(t.mode)}, four in five between ${span(t.q10, t.q90)}`,
      },
      s("rect", {
        class: "band",
        x: x(Math.max(low, t.q10)),
        width: x(Math.min(high, t.q90)) - x(Math.max(low, t.q10)),
        y: EDGE.top,
        height: floor - EDGE.top,
      }),
      axisY(y, ticks(0, top, 4), EDGE.left, WIDTH - EDGE.right, String),
      axisX(x, ticks(low, high, 6), floor + RUG.top + RUG.height, floor, String),
      shown.map((bin) =>
        s(
          "rect",
          {
            class: "count",
            x: x(bin.left) + 0.5,
            width: Math.max(0.5, x(bin.right) - x(bin.left) - 1),
            y: y(bin.bar),
            height: floor - y(bin.bar),
          },
          s("title", {}, `${span(bin.left, bin.right)}: ${count(bin.n)} transitions`),
        ),
      ),
      s("path", { class: "curve", d: points(line) }),
      story.background === null || story.relation === "visible" || story.background > top
        ? null
        : s("line", {
            class: "background",
            x1: EDGE.left,
            x2: WIDTH - EDGE.right,
            y1: y(story.background),
            y2: y(story.background),
          }),
      s("line", { class: "median", x1: x(t.q50), x2: x(t.q50), y1: EDGE.top, y2: floor }),
      samples
        .filter((value) => value >= low && value <= high)
        .map((value) =>
          s("line", { class: "sample", x1: x(value), x2: x(value), y1: floor + 4, y2: floor + 4 + RUG.height }),
        ),
      s(
        "text",
        { class: "title", x: WIDTH - EDGE.right, y: HEIGHT - 6, "text-anchor": "end" },
        "transit time, seconds",
      ),
      s("text", { class: "title", x: EDGE.left, y: EDGE.top - 4 }, "transitions per second of transit time"),
    ),
    h(
      "figcaption",
      { class: "legend" },
      h("span", {}, h("i", { class: "swatch count" }), "counted"),
      h("span", {}, h("i", { class: "swatch curve" }), "fitted curve"),
      h("span", {}, h("i", { class: "swatch median" }), "median"),
      h("span", {}, h("i", { class: "swatch band" }), "middle 80 %"),
      h("span", {}, h("i", { class: "swatch sample" }), `${samples.length} Monte Carlo samples, drawn anew from the fitted curve`),
      story.background === null || story.relation === "visible"
        ? null
        : h(
            "span",
            {},
            h("i", { class: "swatch background" }),
            story.background > top
              ? `background: above this chart, ${scientific(story.background)}`
              : "background level",
          ),
      beyond > 0.005 * story.transitions && beyond > 0.5
        ? h("span", { class: "quiet" }, `${count(beyond)} further out are not shown`)
        : null,
    ),
  );
}
