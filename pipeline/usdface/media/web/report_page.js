// Shared by the report's scripts: data, and helpers for elements.

export const data = JSON.parse(document.getElementById("data").textContent);
export const count = data.frames.length;
export const NOTHING = -32768; // missing weight
export const byId = (id) => document.getElementById(id);

const SVG = "http://www.w3.org/2000/svg";
const DRAWN = new Set(["svg", "path", "polyline"]);

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

/** Show an error permanently; an empty message hides it. */
export function tell(message) {
  byId("fault").textContent = message;
  byId("fault").hidden = !message;
}

/** Show a message below the transport, a live region of screen readers. */
export function announce(message) {
  byId("live").textContent = message;
}

/** The picture of a frame, or of the nearest one. */
export function pictureOf(frame) {
  const first = data.frames[0]; // frames are consecutive
  return Math.min(Math.max(Math.round(frame) - first, 0), count - 1);
}

export function inflate(id) {
  const stream = new Blob([bytesFromBase64(byId(id).textContent)]).stream();
  return new Response(stream.pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}
