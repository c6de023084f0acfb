// Creation of elements, for the tuning page and the report.

const SVG = "http://www.w3.org/2000/svg";
const DRAWN = new Set(["svg", "path", "polyline"]);

/** Create an element with attributes, and elements or text as children. */
export function node(name, attributes = {}, ...children) {
  const made = DRAWN.has(name) ? document.createElementNS(SVG, name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

export function button(label, title, action) {
  const made = node("button", { type: "button", title }, label);
  made.addEventListener("click", action);
  return made;
}
