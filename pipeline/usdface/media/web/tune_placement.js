// Correction of marker positions by dragging them over the face at rest.

const GRAB_PX = 14;
const BEHIND_MM = 40; // depth behind the nearest marker from which others are hidden by the face
const PROPOSED = [0.47, 0.78, 1];
const CORRECTED = [0.51, 0.82, 0.52];

/** Emits `placed` (detail: marker, at) when a marker is dropped, or reset (at is null). */
export class PlacementTool extends EventTarget {
  /** @param {FaceViewer} viewer shows the face at rest while the tool is on */
  constructor(viewer, markers) {
    super();
    this.viewer = viewer;
    this.on = false;
    this.grabbed = -1;
    this.load(markers);
    const listen = (name, action) =>
      viewer.canvas.addEventListener(name, (event) => this.on && action(event), { capture: true });
    listen("pointerdown", (event) => this.#grab(event));
    listen("pointermove", (event) => this.#drag(event));
    listen("pointerup", (event) => this.#drop(event));
    listen("pointercancel", () => this.#leave());
    listen("dblclick", (event) => this.#takeBack(event));
  }

  /** Load the positions of the markers from the server's data. */
  load({ names, rest, corrected, lines }) {
    this.names = names;
    this.lines = lines;
    this.points = Float32Array.from(rest);
    this.corrected = corrected;
    this.colors = new Float32Array(corrected.flatMap((is) => (is ? CORRECTED : PROPOSED)));
  }

  /** Argument of FaceViewer.setMarkers. */
  overlay() {
    const { points, names, colors, lines } = this;
    return { points, names, colors, lines, labels: true, diameter: 10 };
  }

  #at(event) {
    const box = this.viewer.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** The marker nearest to the pointer that is not behind the head, or -1. */
  #under(event) {
    const [x, y] = this.#at(event);
    const near = this.names.map((_, marker) => {
      const [px, py, depth] = this.viewer.project(...this.points.subarray(3 * marker, 3 * marker + 3));
      return { marker, depth, away: Math.hypot(px - x, py - y) };
    }).filter(({ away }) => away <= GRAB_PX);
    const front = Math.min(...near.map(({ depth }) => depth)) + BEHIND_MM;
    const seen = near.filter(({ depth }) => depth < front).sort((a, b) => a.away - b.away);
    return seen[0]?.marker ?? -1;
  }

  #grab(event) {
    const marker = event.button === 0 && !event.shiftKey ? this.#under(event) : -1;
    if (marker < 0) return; // the camera turns
    event.stopImmediatePropagation();
    event.preventDefault();
    this.viewer.canvas.setPointerCapture(event.pointerId);
    this.grabbed = marker;
    this.moved = this.onFace = false;
    this.start = this.#at(event);
    this.before = this.points.slice(3 * marker, 3 * marker + 3);
  }

  #drag(event) {
    if (this.grabbed < 0) return;
    event.stopImmediatePropagation();
    const [x, y] = this.#at(event);
    this.moved ||= Math.hypot(x - this.start[0], y - this.start[1]) > 3;
    const at = this.moved ? this.viewer.pick(x, y) : null;
    if (!at) return; // off the face
    this.onFace = true;
    this.points.set(at, 3 * this.grabbed);
    this.viewer.setMarkers(this.overlay());
  }

  #drop(event) {
    const marker = this.grabbed;
    if (marker < 0) return;
    event.stopImmediatePropagation();
    this.grabbed = -1;
    if (!this.onFace) return;
    this.#tell(marker, Array.from(this.points.subarray(3 * marker, 3 * marker + 3)));
  }

  #leave() {
    if (this.grabbed < 0) return;
    this.points.set(this.before, 3 * this.grabbed);
    this.grabbed = -1;
    this.viewer.setMarkers(this.overlay());
  }

  #takeBack(event) {
    const marker = this.#under(event);
    if (marker < 0) return;
    event.stopImmediatePropagation();
    if (this.corrected[marker]) this.#tell(marker, null);
  }

  #tell(marker, at) {
    this.dispatchEvent(new CustomEvent("placed", { detail: { marker: this.names[marker], at } }));
  }
}
