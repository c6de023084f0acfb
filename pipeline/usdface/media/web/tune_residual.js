// Residual of the rig's markers by part of the face. It measures proposals, but not keys: the
// character's skin moves differently from the performer's, and correct keys often have a larger
// residual than a solve.

import { node } from "./elements.js";

const GOOD_MM = 0.5;
const BAD_MM = 3;
const FULL_BAR_MM = 4;
const ORDER = ["brows", "lids", "cheeks and nose", "mouth", "jaw", "face"];
const KNOTS = [
  [0.45, 0.78, 0.62],
  [0.93, 0.78, 0.34],
  [0.93, 0.38, 0.28],
];
const KEY_KNOTS = [
  [0.86, 0.88, 0.9],
  [0.6, 0.74, 0.9],
  [0.36, 0.58, 0.93],
];

function tone(mm, isKey) {
  const [near, middle, far] = isKey ? KEY_KNOTS : KNOTS;
  const at = 2 * Math.max(0, Math.min(1, (mm - GOOD_MM) / (BAD_MM - GOOD_MM)));
  const [a, b] = at < 1 ? [near, middle] : [middle, far];
  const share = at < 1 ? at : at - 1;
  return a.map((value, k) => value + (b[k] - value) * share);
}

const css = (color) => `rgb(${color.map((value) => Math.round(255 * value)).join(" ")})`;

/** Markers attached to the rig, deformed by the same keys as the face. */
export class Residual {
  /** @param {{names, regions, lines: number[], rest: Float32Array, keyDeltas: Float32Array, targets: Float32Array}} markers */
  constructor(face, markers) {
    this.face = face;
    Object.assign(this, markers);
    this.count = this.names.length;
    this.shares = new Float32Array(face.keyCount);
    this.bound = new Float32Array(3 * this.count);
    this.colors = new Float32Array(3 * this.count);
    this.parts = ORDER.filter((part) => this.regions.includes(part));
  }

  target(pair) {
    return this.targets.subarray(3 * this.count * pair, 3 * this.count * (pair + 1));
  }

  /**
   * Compute the markers' positions, `bound`; return RMS distances by region [mm], '' for the whole.
   * `isKey`: whether the weights are keys; colours are then neutral rather than a rating.
   */
  measure(weights, pair, isKey = false) {
    const { bound, keyDeltas, face } = this;
    const size = 3 * this.count;
    bound.set(this.rest);
    face.weigh(weights, this.shares).forEach((share, key) => {
      if (share === 0) return;
      for (let i = 0, k = key * size; i < size; i++, k++) bound[i] += share * keyDeltas[k];
    });
    const target = this.target(pair);
    const sums = new Map([...this.parts, ""].map((part) => [part, [0, 0]]));
    for (let i = 0; i < this.count; i++) {
      const m = 3 * i;
      const away = Math.hypot(
        bound[m] - target[m], bound[m + 1] - target[m + 1], bound[m + 2] - target[m + 2],
      );
      const part = this.regions[i];
      this.colors.set(part ? tone(away, isKey) : [0.55, 0.55, 0.55], m);
      if (!part) continue;
      for (const key of [part, ""]) {
        const sum = sums.get(key);
        sum[0] += away * away;
        sum[1]++;
      }
    }
    return new Map([...sums].map(([part, [sum, n]]) => [part, Math.sqrt(sum / Math.max(n, 1))]));
  }

  /** Argument of FaceViewer.setMarkers, after `measure`. */
  overlay(pair, labels) {
    const { names, colors, bound, lines } = this;
    return { points: this.target(pair), targets: bound, names, colors, lines, labels };
  }
}

/** Table over the face, with a row per region. */
export class ResidualTable {
  constructor(table, parts) {
    this.table = table;
    this.rows = new Map();
    for (const part of [...parts, ""]) {
      const fill = node("i");
      const distance = node("td");
      const cells = [node("th", { scope: "row" }, part || "whole face"), node("td", { class: "bar" }, fill), distance];
      table.tBodies[0].append(node("tr", { class: part ? "" : "all" }, ...cells));
      this.rows.set(part, { fill, distance });
    }
  }

  show(distances, isKey) {
    this.table.caption.firstChild.data = isKey ? "Distance of markers, mm RMS" : "Residual of the proposal, mm RMS";
    this.table.tFoot.hidden = !isKey;
    for (const [part, { fill, distance }] of this.rows) {
      const mm = distances.get(part);
      distance.textContent = mm.toFixed(2);
      fill.style.setProperty("--share", `${Math.min(100, (100 * mm) / FULL_BAR_MM).toFixed(1)}%`);
      fill.style.setProperty("--tone", css(tone(mm, isKey)));
    }
  }
}
