// Where on the screen a point of the map is: pan and zoom by pointer, wheel, two fingers and keys.

const SCALE_MIN = 0.02;
const SCALE_MAX = 6;
const MOVED_PIXELS = 5;

export class View {
  x = 0;
  y = 0;
  scale = 1;
  touched = false; // by a person; until then the map is fitted to what there is
  #pointers = new Map();
  #moved = 0;
  #drag = null;

  // onChange() after each move; onTap(x, y) for a click or tap in pixels; grab(x, y) returns what is to be called with
  // each further place, or null where the map itself is moved.
  constructor(element, onChange, onTap, grab) {
    this.element = element;
    this.onChange = onChange;
    this.grab = grab;
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

  fromScreen(x, y) {
    return [(x - this.x) / this.scale, (y - this.y) / this.scale];
  }

  zoom(factor, x = this.element.clientWidth / 2, y = this.element.clientHeight / 2) {
    const scale = Math.min(SCALE_MAX, Math.max(SCALE_MIN, this.scale * factor));
    this.x = x - (x - this.x) * (scale / this.scale);
    this.y = y - (y - this.y) * (scale / this.scale);
    this.scale = scale;
    this.touched = true;
    this.onChange();
  }

  // Show the map at a scale, its origin at (x, y) in pixels.
  put(x, y, scale) {
    Object.assign(this, { x, y, scale, touched: false });
    this.onChange();
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
    this.#drag = null;
    if (this.#pointers.size > 1) return;
    this.#moved = 0;
    this.#drag = this.grab(...this.local(event));
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
    } else if (this.#drag) this.#drag(...now);
    else {
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
