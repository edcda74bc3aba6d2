// Who is well: the daemon, and every camera with its reason.

import { fact } from "./camera.js";
import { fill, h, more, say } from "./dom.js";
import { link } from "./place.js";
import { logOut } from "./source.js";
import { clock, count, howMany, plural } from "./words.js";

const ROWS = 200;

export class Health {
  #rows = ROWS;
  #text = "";

  constructor(app) {
    this.app = app;
    const input = h("input", {
      type: "search",
      placeholder: "Name, state or reason",
      "aria-label": "Filter cameras",
      on: {
        input: () => {
          this.#text = input.value.trim().toLowerCase();
          this.#draw();
        },
      },
    });
    this.daemon = h("div", { class: "card" });
    this.said = h("p", { class: "quiet", role: "status" });
    this.table = h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Cameras" });
    this.leave = h("button", { type: "button", hidden: true, on: { click: () => logOut() } }, "Log out");
    this.element = h(
      "section",
      { class: "page" },
      h("div", { class: "title" }, h("h1", {}, "Health"), this.leave),
      this.daemon,
      h("h2", {}, "Cameras"),
      h("div", { class: "tools" }, input),
      this.said,
      this.table,
    );
  }

  async shown() {
    this.#draw();
    await this.app.askHealth();
  }

  update() {
    if (this.element.isConnected) this.#draw();
  }

  #draw() {
    if (!this.app.health) return;
    const { daemon, live, cameras, login } = this.app.health;
    const { between } = this.app;
    this.leave.hidden = !login;
    const events = daemon.events ?? {};
    const rejected = Object.values(daemon.rejects ?? {}).reduce((sum, n) => sum + n, 0);
    fill(
      this.daemon,
      h(
        "h2",
        {},
        "Daemon ",
        h("span", { class: `pill ${live.look}` }, live.words),
      ),
      live.reason ? h("p", { class: "reason" }, live.reason) : null,
      h(
        "dl",
        { class: "figures wide" },
        fact("Stored since start", count(events.stored)),
        fact("Learned ever", count(daemon.learner?.learned)),
        fact("Waiting to be learned", count(events.waiting)),
        fact("Late ever", count(daemon.learner?.late), "Events that came later than others; they are learned all the same"),
        fact(
          "Rejected since start",
          count(rejected),
          Object.entries(daemon.rejects ?? {})
            .map(([why, n]) => `${why}: ${n}`)
            .join(", ") || null,
        ),
        fact("Predictions since start", count(daemon.predictions)),
        between
          ? fact("Between cameras", howMany(between), `By those who left a camera since ${clock(between.since)}`)
          : null,
      ),
    );
    const wanted = cameras.filter((row) => `${row.id} ${row.state} ${row.reason}`.toLowerCase().includes(this.#text));
    const ill = cameras.filter((row) => row.look === "bad").length;
    const needy = ill ? plural(ill, "needs", "need") : "none needs";
    const gone = cameras.filter((row) => row.state === "gone").length;
    const there = plural(cameras.length - gone, "camera");
    say(this.said, `${there}, ${needy} attention${gone ? `; ${count(gone)} gone` : ""}`);
    fill(
      this.table,
      h(
        "table",
        { class: "wide" },
        h(
          "thead",
          {},
          h(
            "tr",
            {},
            ["Camera", "State", "Events", "Last event", "Reason"].map((name, k) =>
              h("th", { scope: "col", class: ["", "", "apart number", "number", "apart"][k] }, name),
            ),
          ),
        ),
        h(
          "tbody",
          {},
          wanted
            .slice(0, this.#rows)
            .map((row) =>
              h(
                "tr",
                {},
                h(
                  "th",
                  { scope: "row" },
                  h("a", { href: link("camera", row.id) }, row.id),
                  h("span", { class: "below reason" }, row.reason),
                ),
                h("td", {}, h("span", { class: `pill ${row.look}` }, row.state)),
                h("td", { class: "apart number" }, count(row.events)),
                h("td", { class: "number" }, row.newest ? this.app.age(row.newest) : "–"),
                h("td", { class: "apart reason" }, row.reason),
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
