// Where on the screen a point of the map is: pan and zoom by pointer, wheel, two fingers and keys.

const SCALE_MIN = 0.02;
const SCALE_MAX = 6;
const FIT_SCALE_MAX = 2.4;
const MOVED_PIXELS = 5;

export class View {
  x = 0;
  y = 0;
  scale = 1;
  touched = false; // by a person; until then the map is fitted to what there is
  #pointers = new Map();
  #moved = 0;

  // onChange() after each move; onTap(x, y) for a click or tap in pixels.
  constructor(element, onChange, onTap) {
    this.element = element;
    this.onChange = onChange;
    element.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    element.addEventListener("pointerdown", (event) => this.#down(event));
    element.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of ["pointerup", "pointercancel"]) {
      element.addEventListener(name, (event) => {
        const tapped = this.#pointers.size === 1 && this.#moved < MOVED_PIXELS && name === "pointerup";
        this.#pointers.delete(event.pointerId);
        if (tapped) onTap(...this.local(event));
      });
    }
  }

  // Pixels from the element's corner.
  local(event) {
    const box = this.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  toScreen(x, y) {
    return [x * this.scale + this.x, y * this.scale + this.y];
  }

  zoom(factor, x = this.element.clientWidth / 2, y = this.element.clientHeight / 2) {
    const scale = Math.min(SCALE_MAX, Math.max(SCALE_MIN, this.scale * factor));
    this.x = x - (x - this.x) * (scale / this.scale);
    this.y = y - (y - this.y) * (scale / this.scale);
    this.scale = scale;
    this.touched = true;
    this.onChange();
  }

  // Show the whole of a box {x, y, width, height} of the map, inside `insets` {top, right, bottom, left} in pixels.
  fit(box, insets) {
    this.place(box, insets);
    this.onChange();
  }

  // The same without telling.
  place(box, insets) {
    const [width, height] = this.#inside(insets);
    this.scale = this.scaleOf(box, insets);
    this.x = insets.left + width / 2 - (box.x + box.width / 2) * this.scale;
    this.y = insets.top + height / 2 - (box.y + box.height / 2) * this.scale;
  }

  // At which scale the box would be shown.
  scaleOf(box, insets) {
    const [width, height] = this.#inside(insets);
    return Math.min(width / Math.max(box.width, 1), height / Math.max(box.height, 1), FIT_SCALE_MAX);
  }

  #inside({ top, right, bottom, left }) {
    const { clientWidth, clientHeight } = this.element;
    return [Math.max(80, clientWidth - left - right), Math.max(80, clientHeight - top - bottom)];
  }

  // Bring a point into the middle, near enough to read its name.
  centre(x, y, scaleMin) {
    this.scale = Math.max(this.scale, scaleMin);
    this.x = this.element.clientWidth / 2 - x * this.scale;
    this.y = this.element.clientHeight / 2 - y * this.scale;
    this.touched = true;
    this.onChange();
  }

  #wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    this.zoom(Math.exp(-0.0016 * lines * event.deltaY), ...this.local(event));
  }

  #down(event) {
    if (event.button !== 0) return;
    this.element.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, this.local(event));
    if (this.#pointers.size === 1) this.#moved = 0;
  }

  #move(event) {
    const before = this.#pointers.get(event.pointerId);
    if (before === undefined) return;
    const now = this.local(event);
    this.#moved += Math.hypot(now[0] - before[0], now[1] - before[1]);
    const others = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    this.#pointers.set(event.pointerId, now);
    if (this.#moved < MOVED_PIXELS) return;
    if (others.length) {
      const [other] = others;
      const factor =
        Math.hypot(now[0] - other[0], now[1] - other[1]) /
        Math.max(1, Math.hypot(before[0] - other[0], before[1] - other[1]));
      this.zoom(factor, other[0], other[1]);
    } else {
      this.x += now[0] - before[0];
      this.y += now[1] - before[1];
      this.touched = true;
      this.onChange();
    }
  }
}

// The distance of a point from the line between two points.
export function fromLine(x, y, a, b) {
  const [dx, dy] = [b.x - a.x, b.y - a.y];
  const along = Math.min(1, Math.max(0, ((x - a.x) * dx + (y - a.y) * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(a.x + along * dx - x, a.y + along * dy - y);
}
