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

export function span(low, high) {
  const digits = Math.max(Math.abs(low), Math.abs(high)) < 10 ? 1 : 0;
  return `${signed(low, digits)} to ${signed(high, digits)} s`;
}

export function percent(share) {
  if (share === null || share === undefined) return "–";
  return `${(100 * share).toFixed(share > 0 && share < 0.0995 ? 1 : 0)} %`;
}

const whole = new Intl.NumberFormat("en"); // much faster than toLocaleString()

export function count(value) {
  if (value === null || value === undefined) return "–";
  return Math.abs(value) < 9.5 && !Number.isInteger(value) ? value.toFixed(1) : whole.format(Math.round(value));
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

// The day of a recording.
export function day(t) {
  return new Date(1000 * t).toLocaleDateString("en-GB", { day: "numeric", month: "long", year: "numeric" });
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

function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  return (value < 0 && Number(text) ? "−" : "") + text;
}
