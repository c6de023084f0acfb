// The face of the report: pose, comparison with a second pose, markers, and heat maps.

import { node } from "./elements.js";
import { NOTHING, byId, count, data, inflate } from "./report_page.js";

const SKIN_PART = 0; // of FacePart in media/face/parts.py
const SEEN = [0.47, 0.78, 1];

/** Captured markers on the character, and their positions in the pose. */
class PlacedMarkers {
  constructor(face, header, motion, keyDeltas) {
    Object.assign(this, header, { face, motion, keyDeltas });
    this.size = 3 * header.names.length;
    this.shares = new Float32Array(face.keyCount);
    this.points = new Float32Array(this.size);
    this.targets = new Float32Array(this.size);
    this.colors = new Float32Array(this.size).map((_, i) => SEEN[i % 3]);
  }

  /** Argument of FaceViewer.setMarkers; `transform` is the head's transform, three rows of four numbers. */
  overlay(weights, picture, transform) {
    const { points, targets, motion, keyDeltas, size } = this;
    targets.set(this.rest);
    this.face.weigh(weights, this.shares).forEach((share, key) => {
      for (let i = 0, k = key * size; share !== 0 && i < size; i++, k++) targets[i] += share * keyDeltas[k];
    });
    for (let i = 0; i < size; i++) {
      const step = motion[picture * size + i];
      points[i] = step === NOTHING ? NaN : this.rest[i] + step / this.steps;
      if (step === NOTHING) targets[i] = NaN; // no line
    }
    if (transform) for (const each of [points, targets]) transformPoints(each, transform);
    return { points, targets, colors: this.colors, names: this.names, lines: this.lines, diameter: 6 };
  }
}

/** Transform points, x y z each, in place. */
function transformPoints(points, [a, b, c, x, d, e, f, y, g, h, i, z]) {
  for (let p = 0; p < points.length; p += 3) {
    const [u, v, w] = points.subarray(p, p + 3);
    points.set([a * u + b * v + c * w + x, d * u + e * v + f * w + y, g * u + h * v + i * w + z], p);
  }
}

/** The player's face. */
export class Stage {
  constructor(viewer, weightsAt) {
    this.viewer = viewer;
    this.weightsAt = weightsAt; // (curve, picture) → weights in the viewer's order
    this.curve = 0;
    this.picture = 0;
    this.markers = null;
    this.transforms = null;
    this.#fill();
  }

  /** Unpack the motion of the head and the markers, if any. */
  async load() {
    byId("headLabel").hidden = !data.transforms;
    if (data.transforms) this.transforms = new Float32Array(await inflate("transforms"));
    byId("markersLabel").hidden = !data.markers;
    if (!data.markers) return;
    const motion = new Int16Array(await inflate("markerMotion"));
    const size = 3 * data.markers.names.length;
    for (let i = size; i < motion.length; i++) motion[i] += motion[i - size]; // undo differences
    const deltas = new Float32Array(await inflate("markerDeltas"));
    this.markers = new PlacedMarkers(this.viewer.face, data.markers, motion, deltas);
  }

  show(picture) {
    this.picture = picture;
    const { viewer } = this;
    const weights = this.weightsAt(this.curve, picture);
    const transforms = this.#transformsAt(picture);
    viewer.face.setTransforms(transforms);
    viewer.setWeights(weights);
    const other = this.other === null ? null : this.weightsAt(this.other, picture);
    const how = byId("how").value;
    viewer.compare(other && how !== "difference" ? { weights: other, how, share: byId("share").valueAsNumber } : null);
    viewer.setMarkers(this.#marked ? this.markers.overlay(weights, picture, transforms) : null);
    this.#paint(weights, other, how);
  }

  get #marked() {
    return this.markers !== null && byId("markers").checked;
  }

  /** Transforms of the head, or null; null with markers unless the head moves rigidly. */
  #transformsAt(picture) {
    byId("head").disabled = this.#marked && !data.movesAsOne;
    if (!this.transforms || !byId("head").checked || byId("head").disabled) return null;
    const size = this.transforms.length / count;
    return this.transforms.subarray(picture * size, (picture + 1) * size);
  }

  again() {
    this.show(this.picture);
  }

  #fill() {
    for (const [index, { name }] of data.curves.entries()) {
      byId("which").append(node("option", { value: index }, name));
      if (index) byId("other").append(node("option", { value: index }, name));
    }
    byId("otherLabel").hidden = data.curves.length < 2;
    byId("heatLabel").hidden = !data.heat;
    if (data.heat) byId("heatName").textContent = data.heat.name;
    this.other = null;
    byId("which").addEventListener("change", (event) => {
      this.curve = Number(event.target.value);
      this.again();
      byId("which").dispatchEvent(new CustomEvent("posed"));
    });
    byId("other").addEventListener("change", (event) => {
      this.other = event.target.value === "" ? null : Number(event.target.value);
      this.#controls();
      this.again();
    });
    byId("how").addEventListener("change", () => { this.#controls(); this.again(); });
    for (const id of ["markers", "heat", "head"]) byId(id).addEventListener("change", () => this.again());
    byId("share").addEventListener("input", () => this.again());
    this.#controls();
  }

  #controls() {
    const compared = this.other !== null;
    // The difference from a baseline is not an error, and has no map.
    const known = compared && data.curves[this.other].kind !== "baseline";
    byId("how").querySelector("[value=difference]").disabled = !known;
    if (!known && byId("how").value === "difference") byId("how").value = "wipe";
    byId("howLabel").hidden = !compared;
    byId("share").hidden = !compared || byId("how").value === "difference";
    byId("poses").textContent = this.#caption();
  }

  #caption() {
    const name = data.curves[this.curve].name;
    if (this.other === null) return name;
    const other = data.curves[this.other].name;
    return { wipe: `${name} | ${other}`, onion: `${name} over ${other}`, difference: `difference of ${name} from ${other}` }[byId("how").value];
  }

  #paint(weights, other, how) {
    const difference = other && how === "difference" ? other : null;
    const heat = byId("heat").checked ? data.heat : null;
    byId("scale").hidden = !difference && !heat;
    byId("poses").textContent = this.#caption();
    if (!difference && !heat) { if (this.viewer.heat) this.viewer.paint(null); return; }
    const against = difference ?? (heat.against === undefined ? null : this.weightsAt(heat.against, this.picture));
    const high = difference ? 1 : heat.high;
    byId("scaleHigh").textContent = `${high} mm`;
    const values = against ? this.#distances(weights, against) : this.#regionValues(heat);
    this.viewer.paint({ values, high, ramp: data.ramp });
  }

  /** Distance of two poses at each point of the skin [mm]; 0 for eyes and teeth. */
  #distances(weights, against) {
    const { face } = this.viewer;
    this.values ??= new Float32Array(face.pointCount);
    this.leftOut ??= data.leftOut.map((name) => face.names.indexOf(name)).filter((at) => at >= 0);
    const skin = Float32Array.from(against); // without shapes of gaze and tongue
    for (const at of this.leftOut) skin[at] = weights[at];
    face.pose(skin);
    this.held ??= new Float32Array(face.positions.length);
    this.held.set(face.positions);
    face.pose(weights);
    const { positions, parts } = face;
    for (let i = 0, m = 0; i < face.pointCount; i++, m += 3) {
      this.values[i] = parts[i] !== SKIN_PART ? 0 : Math.hypot(
        positions[m] - this.held[m], positions[m + 1] - this.held[m + 1], positions[m + 2] - this.held[m + 2],
      );
    }
    return this.values;
  }

  /** Value of each point's region at the picture. */
  #regionValues(heat) {
    this.owners ??= owners(this.viewer.face, heat.regions);
    this.values ??= new Float32Array(this.viewer.face.pointCount);
    for (let i = 0; i < this.values.length; i++) {
      const owner = this.owners[i];
      this.values[i] = owner < 0 ? NaN : heat.values[owner * count + this.picture];
    }
    return this.values;
  }
}

const LEAST_REACH = 0.1; // relative motion below which a point belongs to no region
const CARRIED = 0.85; // factor on the jaw's motion, which also carries the lower lip

/** The region whose shapes move each point most, as in `points_by_region`; −1 for none. */
function owners(face, regions) {
  const best = new Float32Array(face.pointCount).fill(255 * LEAST_REACH);
  const owner = new Int8Array(face.pointCount).fill(-1);
  for (const [shape, { region }] of face.shapes.entries()) {
    const index = regions.indexOf(region);
    if (index < 0) continue;
    const share = region === "jaw" ? CARRIED : 1;
    const reach = face.reach(shape);
    for (let i = 0; i < reach.length; i++) {
      if (share * reach[i] <= best[i]) continue;
      best[i] = share * reach[i];
      owner[i] = index;
    }
  }
  return owner;
}
