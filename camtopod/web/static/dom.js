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

// Replace what is in an element.
export function fill(element, ...children) {
  element.replaceChildren(...flat(children));
  return element;
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
