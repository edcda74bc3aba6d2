// Where the data come from: the server beside this page, or, in a report, the page itself.

export class NotThere extends Error {}

// The server is not reached, or cannot answer now.
export class Away extends Error {}

// The report that is part of this page, which lacks what only a live source has, or the server.
/** @returns {Server} */
export function openSource() {
  const held = document.getElementById("report");
  return held ? /** @type {any} */ (new Report(JSON.parse(held.textContent))) : new Server();
}

class Server {
  live = true;
  hasRecent = true;
  hasGrowth = true;

  map() {
    return get("data/map");
  }
  health() {
    return get("data/health");
  }
  camera(id) {
    return get(`data/camera/${encodeURIComponent(id)}`);
  }
  pair(a, b) {
    return get(`data/pair/${encodeURIComponent(a)}/${encodeURIComponent(b)}`);
  }
  link(from, to, relation) {
    return get(`data/link?${new URLSearchParams({ from, to, relation })}`);
  }
  versions() {
    return get("data/versions");
  }
  // Events of the last hour, {t, events}, and counts by the hour.
  recent() {
    return get("data/recent");
  }
  async hours() {
    return (await get("data/hours")).hours;
  }
  // Newest matches, or all of the last hour, oldest first.
  walks(all = false) {
    return get(all ? "data/walks?all" : "data/walks");
  }
  // Cameras and pairs of earlier versions, oldest first.
  growth() {
    return get("data/growth");
  }
  // Address of the floor plan and the places on it, or null.
  async plan() {
    const placement = await get("data/placement");
    return placement && { href: "plan", ...placement };
  }
  pictures() {
    return get("data/pictures");
  }
  picture(id) {
    return `picture/${encodeURIComponent(id)}`;
  }
}

// End this browser's session.
export async function logOut() {
  await fetch("logout", { method: "POST" });
  location.reload();
}

class Report {
  live = false;

  constructor(held) {
    this.held = held;
    this.hasRecent = Boolean(held.recent);
    this.hasGrowth = held.growth.length > 1;
  }

  async map() {
    return this.held.map;
  }
  async camera(id) {
    return this.#found(this.held.cameras[id]);
  }
  async pair(a, b) {
    return this.#found(this.held.pairs[[a, b].sort().join(" ")]);
  }
  async link(from, to, relation) {
    return this.#found(this.held.links[`${from} ${to} ${relation}`]);
  }
  async versions() {
    return this.held.versions;
  }
  async recent() {
    return this.held.recent;
  }
  async walks() {
    return []; // nothing in a file joins passages of two cameras
  }
  async growth() {
    return this.held.growth;
  }
  async plan() {
    return this.held.plan;
  }
  async pictures() {
    return Object.keys(this.held.pictures);
  }
  picture(id) {
    return this.held.pictures[id];
  }

  #found(value) {
    if (value === undefined) throw new NotThere("This report does not contain it.");
    return value;
  }
}

async function get(path) {
  let answer;
  let content;
  try {
    answer = await fetch(path, { cache: "no-store" });
    content = await answer.json();
  } catch (error) {
    // SyntaxError: a proxy's page instead of an answer
    if (error instanceof TypeError || error instanceof SyntaxError) throw new Away("The server cannot be reached.");
    throw error;
  }
  if (answer.status === 401) location.reload(); // the session has ended: the server leads to the login
  if (answer.status === 404) throw new NotThere(content.error);
  if (!answer.ok) throw new Away(content.error);
  return content;
}
