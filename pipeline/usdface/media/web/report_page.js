// Shared by the report's scripts: data and messages.

export const data = JSON.parse(document.getElementById("data").textContent);
export const count = data.frames.length;
export const NOTHING = -32768; // missing weight or position
export const byId = (id) => document.getElementById(id);

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
