// Unpacking of a face (media/page/face_payload.py), and its deformation by weights.
// Lengths are in millimetres. No dependencies, no build step.

const FORMAT = 4;
const SKIN = 0; // of FacePart in media/face/parts.py
const SHARE = 1 / 32000; // step of skinning weights
const MM = 1e-3; // lengths in the data are micrometres
const TYPES = {
  i1: Int8Array,
  u1: Uint8Array,
  i2: Int16Array,
  i4: Int32Array,
};

/** Decode base64 text, for pages that contain their data. */
export function bytesFromBase64(text) {
  const raw = atob(text.trim());
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

/**
 * Unpack a face.
 * @param {object} header as `FacePayload.header`
 * @param {Uint8Array|ArrayBuffer} data as `FacePayload.data`
 * @returns {Promise<FaceModel>}
 */
export async function unpackFace(header, data) {
  if (header.format !== FORMAT) {
    throw new Error(`this face has format ${header.format}, the viewer reads ${FORMAT}`);
  }
  const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  if (buffer.byteLength !== header.bytes) {
    throw new Error(`the face has ${buffer.byteLength} bytes, ${header.bytes} expected`);
  }
  const array = (name) => {
    const { type, start, count } = header.arrays[name];
    return new TYPES[type](buffer, start, count);
  };
  return new FaceModel(header, array);
}

function sum(values) {
  for (let i = 1; i < values.length; i++) values[i] += values[i - 1];
  return values;
}

/** Integrate planes of differences, x x x … y y y …, and interleave them to x y z x y z …. */
function interleave(planes, count, Type) {
  const out = new Type(3 * count);
  for (let axis = 0; axis < 3; axis++) {
    let value = 0;
    for (let i = 0; i < count; i++) {
      value += planes[axis * count + i];
      out[3 * i + axis] = value;
    }
  }
  return out;
}

/** A face that can be posed: `pose(weights)` fills `positions` and `normals`. */
export class FaceModel {
  constructor(header, array) {
    const count = header.points;
    this.pointCount = count;
    this.shapes = header.shapes;
    this.names = header.shapes.map((shape) => shape.name);
    this.camera = header.camera;
    this.size = header.size;
    const micro = interleave(array("neutral"), count, Int32Array);
    this.neutral = Float32Array.from(micro, (value) => value * MM);
    this.triangles = Uint32Array.from(sum(array("triangles").slice()));
    this.middles = array("middles").slice();
    this.colors = new Uint8Array(4 * count);
    const planes = array("colors");
    for (let i = 0; i < count; i++) {
      for (let k = 0; k < 4; k++) this.colors[4 * i + k] = planes[k * count + i];
    }
    this.parts = array("parts").slice();
    this.rest = this.#rest(array("eyes"), header.eyeCenters);
    this.bands = header.bands;
    this.bare = array("bare").slice();
    this.carriers = header.carriers ? array("carriers").slice() : null; // part by part
    this.transforms = null;
    this.combinations = header.combinations;
    this.channels = new Float64Array(this.shapes.length + this.combinations.length);
    this.tracks = this.#readTracks(header.tracks, array);
    this.keyCount = this.tracks.reduce((total, track) => total + track.keys.length, 0);
    this.keyWeights = new Float32Array(this.keyCount);
    this.positions = Float32Array.from(this.neutral);
    this.normals = new Float32Array(3 * count);
    this.timings = { morph: 0, normals: 0 };
    this.pose(new Float32Array(this.shapes.length));
  }

  /** Positions for colouring: at rest on skin, relative to the centre on an eye. */
  #rest(eyes, centers) {
    const rest = new Float32Array(3 * this.pointCount);
    for (let i = 0; i < this.pointCount; i++) {
      if (eyes[i] < 0 && this.parts[i] !== SKIN) continue;
      const center = eyes[i] < 0 ? [0, 0, 0] : centers[eyes[i]];
      for (let k = 0; k < 3; k++) rest[3 * i + k] = this.neutral[3 * i + k] - center[k];
    }
    return rest;
  }

  #readTracks(tracks, array) {
    const points = array("keyPoints");
    const sources = { false: [array("offsets16"), 0], true: [array("offsets32"), 0] };
    let first = 0;
    let row = 0;
    return tracks.map((track) => ({
      shape: track.shape,
      keys: track.weights.map((weight, k) => {
        const count = track.counts[k];
        const source = sources[track.wide[k]];
        const planes = source[0].subarray(source[1], source[1] + 3 * count);
        const key = {
          row: row++,
          weight,
          points: sum(Int32Array.from(points.subarray(first, first + count))),
          offsets: interleave(planes, count, track.wide[k] ? Int32Array : Int16Array),
        };
        first += count;
        source[1] += 3 * count;
        return key;
      }),
    }));
  }

  /**
   * Convert channel weights to key weights: combinations as in core/rig_logic.py, then UsdSkel's
   * rule: linear between neighbouring keys, with the neutral as a key at 0, and linear beyond the
   * outermost.
   * @param {ArrayLike<number>} weights one per shape
   * @param {Float32Array} [out]
   */
  weigh(weights, out = this.keyWeights) {
    out.fill(0);
    const channels = this.#combine(weights);
    for (const { shape, keys } of this.tracks) {
      const w = channels[shape];
      if (w === 0) continue;
      const stops = this.#stops(keys);
      let upper = 1;
      while (upper < stops.length - 1 && w >= stops[upper].weight) upper++;
      const a = stops[upper - 1];
      const b = stops[upper];
      const toward = (w - a.weight) / (b.weight - a.weight);
      if (a.row >= 0) out[a.row] += 1 - toward;
      if (b.row >= 0) out[b.row] += toward;
    }
    return out;
  }

  /** Append the weights of combinations to those of the shapes. */
  #combine(weights) {
    const { channels } = this;
    for (let i = 0; i < this.shapes.length; i++) channels[i] = weights[i];
    for (const { shape, mode, parts, low, peak, high } of this.combinations) {
      const factors = parts.map((part, k) => {
        const w = channels[part];
        const rising = (w - low[k]) / (peak[k] - low[k]);
        if (high[k] === null) return Math.max(rising, 0);
        return Math.max(Math.min(rising, (high[k] - w) / (high[k] - peak[k])), 0);
      });
      if (mode === "product") channels[shape] = factors.reduce((all, each) => all * each, 1);
      else if (mode === "minimum") channels[shape] = Math.min(...factors);
      else channels[shape] = factors.length / factors.reduce((all, each) => all + 1 / each, 0);
    }
    return channels;
  }

  #stops(keys) {
    if (!keys.stops) {
      keys.stops = [...keys, { row: -1, weight: 0 }].sort((a, b) => a.weight - b.weight);
    }
    return keys.stops;
  }

  /**
   * Set the transforms of joints and Xforms for the following poses; null for rest.
   * @param {null | Float32Array} transforms three rows of four numbers per part [mm]
   */
  setTransforms(transforms) {
    this.transforms = transforms;
  }

  /** Former name of setTransforms. */
  carry(transforms) {
    this.setTransforms(transforms);
  }

  /** Apply the transforms by linear blend skinning. */
  #applyTransforms() {
    const { transforms, carriers, positions, pointCount } = this;
    if (!transforms) return;
    const before = positions.slice();
    for (let part = 0, t = 0; t < transforms.length; part++, t += 12) {
      for (let i = 0, p = 0; i < pointCount; i++, p += 3) {
        const share = carriers[part * pointCount + i] * SHARE;
        if (share === 0) continue;
        for (let k = 0, r = t; k < 3; k++, r += 4) {
          const to = transforms[r] * before[p] + transforms[r + 1] * before[p + 1] + transforms[r + 2] * before[p + 2] + transforms[r + 3];
          positions[p + k] += share * (to - before[p + k]);
        }
      }
    }
  }

  /** Compute points and normals for weights. */
  pose(weights) {
    const begun = performance.now();
    const { positions, triangles, normals } = this;
    const shares = this.weigh(weights);
    positions.set(this.neutral);
    for (const { keys } of this.tracks) {
      for (const { row, points, offsets } of keys) {
        if (shares[row] === 0) continue;
        const share = shares[row] * MM;
        for (let i = 0, m = 0; i < points.length; i++, m += 3) {
          const p = 3 * points[i];
          positions[p] += share * offsets[m];
          positions[p + 1] += share * offsets[m + 1];
          positions[p + 2] += share * offsets[m + 2];
        }
      }
    }
    this.#applyTransforms();
    const moved = performance.now();
    normals.fill(0);
    for (let t = 0; t < triangles.length; t += 3) {
      const a = 3 * triangles[t];
      const b = 3 * triangles[t + 1];
      const c = 3 * triangles[t + 2];
      const ax = positions[a];
      const ay = positions[a + 1];
      const az = positions[a + 2];
      const ux = positions[b] - ax;
      const uy = positions[b + 1] - ay;
      const uz = positions[b + 2] - az;
      const vx = positions[c] - ax;
      const vy = positions[c + 1] - ay;
      const vz = positions[c + 2] - az;
      const x = uy * vz - uz * vy; // proportional to the area; normalised in the shader
      const y = uz * vx - ux * vz;
      const z = ux * vy - uy * vx;
      normals[a] += x;
      normals[a + 1] += y;
      normals[a + 2] += z;
      normals[b] += x;
      normals[b + 1] += y;
      normals[b + 2] += z;
      normals[c] += x;
      normals[c + 1] += y;
      normals[c + 2] += z;
    }
    this.#smoothMiddles();
    this.timings.morph = moved - begun;
    this.timings.normals = performance.now() - moved;
  }

  /** Give the centre point of a quad the mean normal of its corners. */
  #smoothMiddles() {
    const { middles, normals } = this;
    for (let row = 0; row < middles.length; row += 5) {
      let x = 0;
      let y = 0;
      let z = 0;
      for (let k = 1; k < 5; k++) {
        const c = 3 * middles[row + k];
        const share = 1 / (Math.hypot(normals[c], normals[c + 1], normals[c + 2]) || 1);
        x += share * normals[c];
        y += share * normals[c + 1];
        z += share * normals[c + 2];
      }
      const m = 3 * middles[row];
      normals[m] = x;
      normals[m + 1] = y;
      normals[m + 2] = z;
    }
  }

  /** Distance along a ray to the posed skin; null without a hit. */
  hit(from, along) {
    const { positions, triangles, parts } = this;
    let nearest = null;
    const [dx, dy, dz] = along;
    for (let t = 0; t < triangles.length; t += 3) {
      if (parts[triangles[t]] !== SKIN) continue; // eyes and teeth have no markers
      const a = 3 * triangles[t];
      const b = 3 * triangles[t + 1];
      const c = 3 * triangles[t + 2];
      const ux = positions[b] - positions[a];
      const uy = positions[b + 1] - positions[a + 1];
      const uz = positions[b + 2] - positions[a + 2];
      const vx = positions[c] - positions[a];
      const vy = positions[c + 1] - positions[a + 1];
      const vz = positions[c + 2] - positions[a + 2];
      const hx = dy * vz - dz * vy;
      const hy = dz * vx - dx * vz;
      const hz = dx * vy - dy * vx;
      const size = ux * hx + uy * hy + uz * hz;
      if (Math.abs(size) < 1e-12) continue;
      const sx = from[0] - positions[a];
      const sy = from[1] - positions[a + 1];
      const sz = from[2] - positions[a + 2];
      const first = (sx * hx + sy * hy + sz * hz) / size;
      if (first < 0 || first > 1) continue;
      const qx = sy * uz - sz * uy;
      const qy = sz * ux - sx * uz;
      const qz = sx * uy - sy * ux;
      const second = (dx * qx + dy * qy + dz * qz) / size;
      if (second < 0 || first + second > 1) continue;
      const reach = (vx * qx + vy * qy + vz * qz) / size;
      if (reach > 0 && (nearest === null || reach < nearest)) nearest = reach;
    }
    return nearest;
  }

  /** Displacement of each point by a shape, 0 to 255 relative to the largest. */
  reach(shape) {
    const far = new Float32Array(this.pointCount);
    let most = 0;
    for (const track of this.tracks) {
      if (track.shape !== shape) continue;
      const { points, offsets } = track.keys[track.keys.length - 1];
      for (let i = 0; i < points.length; i++) {
        const m = 3 * i;
        const length = Math.hypot(offsets[m], offsets[m + 1], offsets[m + 2]);
        far[points[i]] = length;
        most = Math.max(most, length);
      }
    }
    return Uint8Array.from(far, (length) => (most > 0 ? (255 * length) / most : 0));
  }
}
