// What the parts of the report share: its data, and ways to make and find elements.

export const data = JSON.parse(document.getElementById("data").textContent);
export const count = data.frames.length;
export const NOTHING = -32768; // of weights in steps
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

/** A fault stays on the page. */
export function tell(message) {
  byId("fault").textContent = message;
  byId("fault").hidden = !message;
}

/** Say something in the line below the transport, which readers read out. */
export function announce(message) {
  byId("live").textContent = message;
}

/** The picture of a frame, or of the nearest one that the page has. */
export function pictureOf(frame) {
  const first = data.frames[0]; // frames are consecutive
  return Math.min(Math.max(Math.round(frame) - first, 0), count - 1);
}

export function inflate(id) {
  const stream = new Blob([bytesFromBase64(byId(id).textContent)]).stream();
  return new Response(stream.pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}
