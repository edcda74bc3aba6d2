// Numbers and times as people read them.

export function seconds(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  const text = size < 10 ? size.toFixed(1) : size < 120 ? size.toFixed(0) : "";
  return (value < 0 ? "−" : "") + (text ? `${text} s` : `${(size / 60).toFixed(1)} min`);
}

// A transit time; a negative one is of views that overlap: the object appears before it leaves.
export function transit(value) {
  return value < 0 ? `${seconds(-value)} before leaving` : seconds(value);
}

// When somebody is expected, seconds from now; where views overlap they may have appeared already.
export function expected({ q10, q90 }) {
  if (q90 < 0.5) return "in view now";
  return q10 < 0 ? `within ${seconds(q90)}` : `in ${span(q10, q90)}`;
}

export function span(low, high) {
  const digits = Math.max(Math.abs(low), Math.abs(high)) < 10 ? 1 : 0;
  return `${signed(low, digits)} to ${signed(high, digits)} s`;
}

export function percent(share) {
  if (share === null || share === undefined) return "–";
  return `${(100 * share).toFixed(share > 0 && share < 0.0995 ? 1 : 0)} %`;
}

export function count(value) {
  if (value === null || value === undefined) return "–";
  return Math.abs(value) < 9.5 && !Number.isInteger(value) ? value.toFixed(1) : Math.round(value).toLocaleString("en");
}

export function plural(value, one, many = `${one}s`) {
  return `${count(value)} ${value === 1 ? one : many}`;
}

// A very small or large number with two digits: 1.2e-12 as 1.2 × 10⁻¹².
export function scientific(value) {
  if (value === 0) return "0";
  if (Math.abs(value) >= 0.001 && Math.abs(value) < 1000) return String(Number(value.toPrecision(2)));
  const [digits, power] = value.toExponential(1).split("e");
  const raised = [...String(Number(power))].map((c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(c)])).join("");
  return `${Number(digits)} × 10${raised}`;
}

const RECORDING_MAX = 1e8; // seconds; times below are counted from a recording's begin, not from 1970

// Time of day, with the date where it is not today's.
export function clock(t) {
  if (t < RECORDING_MAX) return `${count(t)} s`;
  const date = new Date(1000 * t);
  const time = date.toLocaleTimeString("en-GB");
  const today = date.toDateString() === new Date().toDateString();
  return today ? time : `${date.toLocaleDateString("en-CA")} ${time.slice(0, 5)}`;
}

// The same for the axis of a chart that is `range` seconds wide: the day where it is of days.
export function axisTime(t, range) {
  if (t < RECORDING_MAX) return `${count(t)} s`;
  const date = new Date(1000 * t);
  if (range > 2 * 86400) return date.toLocaleDateString("en-GB", { day: "numeric", month: "short" });
  const time = date.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
  return range > 43200 ? `${date.toLocaleDateString("en-GB", { weekday: "short" })} ${time}` : time;
}

export function ago(age) {
  if (!Number.isFinite(age)) return "–";
  if (age < 1.5) return "now";
  if (age < 90) return `${age.toFixed(0)} s ago`;
  if (age < 5400) return `${(age / 60).toFixed(0)} min ago`;
  return age < 172800 ? `${(age / 3600).toFixed(0)} h ago` : `${(age / 86400).toFixed(0)} days ago`;
}

// How many objects are expected between cameras.
export function howMany({ number, low, high }) {
  return `about ${number.toFixed(number < 10 ? 1 : 0)}, ${low} to ${high}`;
}

// Since when a camera is gone: its last event.
export function goneSince({ newest }) {
  return newest ? `gone since ${clock(newest)}` : "gone";
}

// Where an object goes, as [a camera or null, the rest in words]; it is told as a fact only if it is more likely than not.
// known: whether it is known where objects of that camera go.
export function headline({ camera, now, look, next, leave }, known) {
  if (now.length) return [now[0].camera, `${percent(now[0].probability)}, in view now`];
  const best = look[0] ?? next.find((one) => one.camera !== camera);
  if (best?.probability > 0.5)
    return [best.camera, `${percent(best.probability)}, ${look.length ? "look there now or next" : expected(best)}`];
  if (known && leave > 0.5) return [null, `leaves the site, ${percent(leave)}`];
  if (!best || leave > 0.5) return [null, "not known yet"];
  const others = Math.max(0, 1 - leave - best.probability);
  return [null, `most likely ${best.camera}, ${percent(best.probability)}; others ${percent(others)}`];
}

// Whether an object most likely appears next where it has just left.
export function comesBack({ camera, next, now, leave }) {
  return !now.length && next.length > 0 && next[0].camera === camera && next[0].probability >= leave;
}

// Whether a camera's state asks for attention.
export function troubled(state) {
  const fine = ["running", "ended", "unknown", "no grabber", "events from another program", "gone", "forgotten"];
  return state !== undefined && !fine.includes(state);
}

// The look of a state.
export function stateClass(state) {
  return `pill ${troubled(state) ? "bad" : state === "running" ? "good" : "off"}`;
}

function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  return (value < 0 && Number(text) ? "−" : "") + text;
}
