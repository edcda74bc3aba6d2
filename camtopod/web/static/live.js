// The connection that brings what is new. It comes back by itself; what was missed is fetched.

const SILENT_SECONDS = 12; // the server says something every 4 s
const RETRY_SECONDS = 2;

export class Connection {
  #events = null;
  #heard = performance.now();
  #opened = 0;
  #lostSince = null;
  #refused = ""; // why the server does not let this page in, in its own words

  // handlers: {version, cameras, prediction, past, match, seen, beat, lost(since or null, why)}
  constructor(handlers) {
    this.handlers = handlers;
    this.offset = 0; // seconds that the server's clock is ahead of this one's
    this.#open();
    setInterval(() => this.#look(), 1000);
    // A page that nobody sees (another tab, or kept for the way back) gives its connection up: a browser has six.
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.#events.close();
      else this.#comeBack();
    });
  }

  // The server's time, seconds since the epoch.
  now() {
    return Date.now() / 1000 + this.offset;
  }

  #open() {
    this.#events?.close();
    const events = (this.#events = new EventSource("live"));
    this.#opened = performance.now();
    for (const name of ["version", "cameras", "prediction", "past", "match", "seen", "beat"]) {
      events.addEventListener(name, (message) => {
        const content = JSON.parse(message.data);
        this.#alive(name === "beat" ? content.now : null);
        this.handlers[name]?.(content);
      });
    }
    events.addEventListener("error", () => {
      if (events !== this.#events) return;
      if (events.readyState === EventSource.CLOSED) this.#askWhy();
      else this.#refuse(""); // it is not reached
    });
  }

  // An EventSource does not tell what a server answers that refuses it.
  async #askWhy() {
    const asked = new AbortController();
    let why = "";
    try {
      const answer = await fetch("live", { cache: "no-store", signal: asked.signal });
      if (answer.status === 401) location.reload(); // the session has ended
      if (!answer.ok) why = (await answer.json()).error ?? "";
    } catch (error) {
      if (!(error instanceof TypeError || error instanceof SyntaxError)) throw error; // as for any other question
    }
    asked.abort();
    this.#refuse(why);
  }

  #refuse(why) {
    this.#refused = why;
    if (this.#lostSince !== null) this.handlers.lost(this.#lostSince, why);
  }

  #comeBack() {
    this.#heard = performance.now();
    this.#open();
  }

  #alive(now) {
    this.#heard = performance.now();
    if (now !== null) this.offset = now - Date.now() / 1000;
    if (this.#lostSince !== null) {
      this.#lostSince = null;
      this.handlers.lost(null, "");
    }
  }

  #look() {
    if (document.hidden) return;
    const quiet = (performance.now() - this.#heard) / 1000;
    const closed = this.#events.readyState !== EventSource.OPEN;
    if (this.#lostSince === null && (quiet > SILENT_SECONDS || (closed && quiet > RETRY_SECONDS))) {
      this.#lostSince = this.now() - quiet;
      this.handlers.lost(this.#lostSince, this.#refused);
    }
    const age = (performance.now() - this.#opened) / 1000;
    const given = this.#events.readyState === EventSource.CLOSED ? RETRY_SECONDS : SILENT_SECONDS;
    if (quiet > given && age > given) this.#open();
  }
}
