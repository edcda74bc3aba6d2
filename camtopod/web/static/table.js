// The links as a table: the map for those who do not see it, and for whoever wants to sort.

import { fill, h, more, say } from "./dom.js";
import { link } from "./place.js";
import { count, percent, plural, seconds, span } from "./words.js";

const ROWS = 200;
/** @type {[string, (way: any) => any][]} */
const COLUMNS = [
  ["From", (way) => way.from],
  ["To", (way) => way.to],
  ["Kind", (way) => way.kind],
  ["Share", (way) => -way.probability],
  ["Time", (way) => way.transit.mode],
  ["Middle 80 %", (way) => way.transit.q10],
  ["Traffic", (way) => -way.transitions],
];

const sortOf = (name) => (["Share", "Traffic"].includes(name) ? "descending" : "ascending");

export class LinkTable {
  #order = 6;
  #rows = ROWS;
  #text = "";

  constructor() {
    const input = h("input", {
      type: "search",
      placeholder: "Filter by camera",
      "aria-label": "Filter links by camera",
      on: {
        input: () => {
          this.#text = input.value.trim().toLowerCase();
          this.#rows = ROWS;
          this.#draw();
        },
      },
    });
    this.waiting = h("div", {});
    this.said = h("p", { class: "quiet", role: "status" });
    this.place = h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Links" });
    this.element = h(
      "section",
      { class: "page" },
      h("h1", {}, "Links between cameras"),
      h("div", { class: "tools" }, input),
      this.said,
      this.waiting,
      this.place,
    );
  }

  update(map) {
    this.map = map;
    if (this.element.isConnected) this.#draw();
  }

  shown() {
    this.#draw();
  }

  #draw() {
    const ways = Object.values(this.map?.edges ?? {}).flatMap((edge) =>
      edge.ways.map((way) => ({
        ...way,
        kind:
          (edge.relation === "overlapped" ? "overlapping" : "unseen path") +
          (!edge.published ? ", likely" : edge.provisional ? ", provisional" : ""),
        look: !edge.published ? " likely" : edge.provisional ? " provisional" : "",
        published: edge.published,
        provisional: edge.provisional,
      })),
    );
    const wanted = ways.filter(
      (way) => way.from.toLowerCase().includes(this.#text) || way.to.toLowerCase().includes(this.#text),
    );
    const by = COLUMNS[this.#order][1];
    wanted.sort((a, b) => (by(a) < by(b) ? -1 : by(a) > by(b) ? 1 : 0));
    const likely = ways.filter((way) => !way.published).length;
    const all = plural(ways.length - likely, "link") + (likely ? ` and ${count(likely)} likely` : "");
    fill(this.waiting, this.map?.waiting ? h("p", {}, this.map.waiting) : null);
    say(this.said, wanted.length === ways.length ? all : `${count(wanted.length)} of ${all}`);
    fill(
      this.place,
      h(
        "table",
        { class: "wide" },
        h(
          "thead",
          {},
          h(
            "tr",
            {},
            COLUMNS.map(([name], k) =>
              h(
                "th",
                { scope: "col", "aria-sort": k === this.#order ? sortOf(name) : null, class: k > 4 ? "apart number" : k > 2 ? "number" : null },
                h(
                  "button",
                  {
                    type: "button",
                    class: "sort",
                    on: {
                      click: () => {
                        this.#order = k;
                        this.#draw();
                      },
                    },
                  },
                  name,
                ),
              ),
            ),
          ),
        ),
        h(
          "tbody",
          {},
          wanted.slice(0, this.#rows).map((way) =>
            h(
              "tr",
              {},
              h(
                "th",
                { scope: "row" },
                h("a", { href: link("pair", way.from, way.to), "aria-label": `${way.from} to ${way.to}` }, way.from),
              ),
              h("td", {}, way.to),
              h(
                "td",
                { title: way.provisional || null },
                h("span", {
                  class: `stroke ${way.kind.startsWith("over") ? "overlapped" : "unseen"}${way.look}`,
                }),
                h("span", { class: "apart" }, way.kind),
              ),
              h("td", { class: "number" }, percent(way.probability)),
              h("td", { class: "number" }, way.transit.mode < 0 ? `${seconds(-way.transit.mode)} before` : seconds(way.transit.mode)),
              h("td", { class: "apart number" }, span(way.transit.q10, way.transit.q90)),
              h("td", { class: "apart number" }, count(way.transitions)),
            ),
          ),
        ),
      ),
      wanted.length > this.#rows &&
        more(`Show ${count(Math.min(ROWS, wanted.length - this.#rows))} more`, () => {
          this.#rows += ROWS;
          this.#draw();
        }),
    );
  }
}
