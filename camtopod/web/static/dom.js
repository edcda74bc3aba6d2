// Elements from names, properties and children. Text is only ever set as text, never parsed as HTML.

const SVG = "http://www.w3.org/2000/svg";

// An HTML element. Properties: `class`, `on: {event: handler}`, `data: {...}`, attributes; null and false are left out.
export function h(tag, properties = {}, ...children) {
  return filled(document.createElement(tag), properties, children);
}

// The same for SVG.
export function s(tag, properties = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), properties, children);
}

// The button below a table that has further rows.
export function more(text, onClick) {
  return h("button", { type: "button", class: "more", on: { click: onClick } }, text);
}

// Replace what is in an element. Who was on something in it by keyboard is then on what took its place,
// and what has been unfolded stays so.
export function fill(element, ...children) {
  const held = document.activeElement;
  const name = held !== element && element.contains(held) ? nameOf(held) : null;
  const open = new Set([...element.querySelectorAll("details[open] > summary")].map(nameOf));
  element.replaceChildren(...flat(children));
  for (const summary of element.querySelectorAll("details > summary"))
    if (open.has(nameOf(summary))) summary.parentElement.open = true;
  if (name !== null && document.activeElement !== held) {
    const same = [...element.querySelectorAll("a, button, input, h2, summary, [tabindex]")].find((one) => nameOf(one) === name);
    (same ?? element.closest("[tabindex]"))?.focus({ preventScroll: true });
  }
  return element;
}

// Set a text that is read out when it changes, so that it is not read out when it has not.
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function nameOf(element) {
  const own = element.getAttribute("href") ?? element.getAttribute("aria-label");
  return `${element.tagName} ${own ?? (element.className === "more" ? "more" : element.textContent)}`;
}

function filled(element, properties, children) {
  for (const [name, value] of Object.entries(properties)) {
    if (name === "on") {
      for (const [event, handler] of Object.entries(value)) element.addEventListener(event, handler);
    } else if (name === "data") {
      Object.assign(element.dataset, value);
    } else if (value !== null && value !== undefined && value !== false) {
      element.setAttribute(name, value === true ? "" : value);
    }
  }
  element.append(...flat(children));
  return element;
}

function flat(children) {
  return children.flat(3).filter((child) => child !== null && child !== undefined && child !== false);
}
