// How far the rig's markers are from the captured ones, live, by part of the face.

const GOOD_MM = 0.5;
const BAD_MM = 3;
const FULL_BAR_MM = 4;
const ORDER = ["brows", "lids", "cheeks and nose", "mouth", "jaw", "face"];
const KNOTS = [
  [0.45, 0.78, 0.62],
  [0.93, 0.78, 0.34],
  [0.93, 0.38, 0.28],
];

function tone(mm) {
  const at = 2 * Math.max(0, Math.min(1, (mm - GOOD_MM) / (BAD_MM - GOOD_MM)));
  const [a, b] = at < 1 ? [KNOTS[0], KNOTS[1]] : [KNOTS[1], KNOTS[2]];
  const share = at < 1 ? at : at - 1;
  return a.map((value, k) => value + (b[k] - value) * share);
}

const css = (color) => `rgb(${color.map((value) => Math.round(255 * value)).join(" ")})`;

/** Markers glued to the rig, by the same keys as the face. */
export class Residual {
  /** @param {{names, regions, rest: Float32Array, keyDeltas: Float32Array, targets: Float32Array}} markers */
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

  /** Where weights put the markers, in `bound`; and distances by region [mm], the whole under ''. */
  measure(weights, pair) {
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
      this.colors.set(part ? tone(away) : [0.55, 0.55, 0.55], m);
      if (!part) continue;
      for (const key of [part, ""]) {
        const sum = sums.get(key);
        sum[0] += away * away;
        sum[1]++;
      }
    }
    return new Map([...sums].map(([part, [sum, n]]) => [part, Math.sqrt(sum / Math.max(n, 1))]));
  }

  /** What FaceViewer.setMarkers takes, after `measure`. */
  overlay(pair, labels) {
    const { names, colors, bound } = this;
    return { points: this.target(pair), targets: bound, names, colors, labels };
  }
}

/** The table over the face: a row a region, now and as proposed. */
export class ResidualTable {
  constructor(body, parts) {
    this.rows = new Map();
    for (const part of [...parts, ""]) {
      const row = body.insertRow();
      if (!part) row.className = "all";
      const name = document.createElement("th");
      name.textContent = part || "whole face";
      name.scope = "row";
      const bar = document.createElement("td");
      bar.className = "bar";
      const fill = document.createElement("i");
      bar.append(fill);
      const now = document.createElement("td");
      const was = document.createElement("td");
      was.className = "was";
      was.title = "as proposed";
      row.append(name, bar, now, was);
      this.rows.set(part, { fill, now, was });
    }
  }

  show(now, was) {
    const width = (mm) => `${Math.min(100, (100 * mm) / FULL_BAR_MM).toFixed(1)}%`;
    for (const [part, row] of this.rows) {
      row.now.textContent = now.get(part).toFixed(2);
      row.was.textContent = was.get(part).toFixed(2);
      row.fill.style.setProperty("--now", width(now.get(part)));
      row.fill.style.setProperty("--was", width(was.get(part)));
      row.fill.style.setProperty("--tone", css(tone(now.get(part))));
    }
  }
}
