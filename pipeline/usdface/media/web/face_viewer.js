// Viewer of a face in WebGL2, shared by the tuning page and the report.
//
//   const face = await unpackFace(header, bytes);
//   const viewer = new FaceViewer(canvas, face);
//   viewer.setWeights(weights);            // Float32Array, one per shape of face.names
//
// See docs/face_viewer.md for embedding, also into pages opened from disk.

import { FaceModel, bytesFromBase64, unpackFace } from "./face_model.js";
import { FACE_FRAGMENT, FACE_VERTEX, MARK_FRAGMENT, MARK_VERTEX } from "./face_shaders.js";
import { MarkerLabels } from "./marker_labels.js";
import { OrbitCamera, steer } from "./orbit_camera.js";

export { FaceModel, bytesFromBase64, unpackFace };

const SAMPLES = 4;
const FRONT = 0;

function compile(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    gl.deleteShader(shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`the face's shaders do not link: ${gl.getProgramInfoLog(program)}`);
  }
  const uniforms = {};
  for (let i = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) - 1; i >= 0; i--) {
    const { name } = gl.getActiveUniform(program, i);
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return { program, uniforms };
}

/** Draws a FaceModel into a canvas, on changes only. */
export class FaceViewer {
  /**
   * @param {HTMLCanvasElement} canvas sized by CSS; give it tabindex="0" for the keyboard
   * @param {FaceModel} face
   * @param {{interactive?: boolean, onDraw?: (viewer: FaceViewer) => void}} [options]
   */
  constructor(canvas, face, { interactive = true, onDraw = null } = {}) {
    this.canvas = canvas;
    this.face = face;
    this.onDraw = onDraw;
    this.camera = new OrbitCamera(face.camera, face.size);
    this.weights = new Float32Array(face.shapes.length);
    this.renderMillis = 0;
    this.posed = true;
    this.reach = null;
    this.heat = null;
    this.compared = null;
    this.marks = null;
    this.request = 0;
    const gl = canvas.getContext("webgl2", { alpha: true, antialias: true });
    if (!gl) {
      throw new Error("this browser has no WebGL2; use a current Chrome, Edge, Firefox or Safari");
    }
    this.gl = gl;
    this.listeners = {
      webglcontextlost: (event) => event.preventDefault(), // required for restoration
      webglcontextrestored: () => {
        this.#upload();
        this.invalidate();
      },
    };
    for (const [name, listener] of Object.entries(this.listeners)) {
      canvas.addEventListener(name, listener);
    }
    this.release = interactive ? steer(canvas, this.camera, () => this.invalidate()) : () => {};
    this.observer = new ResizeObserver(() => this.invalidate());
    this.observer.observe(canvas);
    this.#upload();
    this.invalidate();
  }

  /** Pose the face: one weight per shape, in the order of `face.names`. */
  setWeights(weights) {
    if (weights.length !== this.weights.length) {
      throw new Error(`${weights.length} weights for ${this.weights.length} shapes`);
    }
    this.weights.set(weights);
    this.posed = false;
    this.invalidate();
  }

  /**
   * Show markers over the face; null removes them.
   * @param {null | {
   *   points: Float32Array,      x y z of each marker [mm], in the rig's space
   *   targets?: Float32Array,    expected positions, joined to the markers by lines
   *   lines?: ArrayLike<number>, pairs of markers joined by thin lines, such as along a lip
   *   names?: string[],          drawn if `labels` is true
   *   colors?: Float32Array,     r g b of each, 0 to 1
   *   labels?: boolean,
   *   diameter?: number,         [CSS pixels]
   * }} marks
   */
  setMarkers(marks) {
    this.marks = marks && { diameter: 7, labels: false, ...marks };
    this.invalidate();
  }

  /** Tint the points that a shape moves; null removes the tint. */
  highlight(shape) {
    if (this.reachShape === shape) return;
    this.reachShape = shape;
    this.reach = shape === null ? null : this.face.reach(shape);
    this.reachChanged = true;
    this.invalidate();
  }

  /**
   * Show a heat map on the skin; null removes it. Not together with `highlight`.
   * @param {null | {
   *   values: Float32Array,  one per point; NaN is grey
   *   high: number,          value of the last colour; the first is 0
   *   ramp: number[][],      five colours, r g b in linear light
   * }} heat
   */
  paint(heat) {
    this.heat = heat;
    const known = (v) => 1 + 254 * Math.min(Math.max(v / heat.high, 0), 1); // 0 is unknown
    this.reach = heat && Uint8Array.from(heat.values, (v) => (Number.isNaN(v) ? 0 : known(v)));
    this.reachChanged = true;
    this.invalidate();
  }

  /**
   * Compare with a second pose; null for none.
   * @param {null | {weights: Float32Array, how: "wipe" | "onion", share: number}} compared
   *   `share`: share of the width, or opacity, of the first pose [0-1]
   */
  compare(compared) {
    this.compared = compared;
    this.posed = false;
    this.invalidate();
  }

  /** Frame the face from the current direction. */
  frameFace() {
    this.camera.frame();
    this.invalidate();
  }

  /** Frame the face from a direction, by default the front [degrees]. */
  resetView(yaw = FRONT, pitch = 0, roll = 0) {
    this.camera.reset(...[yaw, pitch, roll].map((degrees) => (degrees * Math.PI) / 180));
    this.invalidate();
  }

  /** Draw at the next frame. */
  invalidate() {
    if (!this.request) {
      this.request = requestAnimationFrame(() => {
        this.request = 0;
        this.draw();
      });
    }
  }

  /** Draw now; `renderMillis` is the script's time, from weights to commands. */
  draw() {
    const { gl, canvas } = this;
    if (gl.isContextLost()) return;
    const ratio = Math.min(globalThis.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * ratio);
    const height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    const begun = performance.now();
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.view = this.camera.view();
    this.projection = this.camera.projection(width / height);
    if (this.compared) this.#drawCompared(width, height);
    else {
      this.#pose(this.weights);
      this.#drawFace(width, height);
    }
    if (this.marks) this.#drawMarks(ratio);
    if (this.marks?.labels) this.labels ??= new MarkerLabels(canvas);
    this.labels?.draw(this, ratio);
    this.renderMillis = performance.now() - begun;
    this.onDraw?.(this);
  }

  /** Project a point of the rig to the canvas: x, y [CSS pixels] and depth [mm]. */
  project(x, y, z) {
    const [v, p] = [this.view, this.projection];
    const eye = [0, 1, 2].map((k) => v[k] * x + v[4 + k] * y + v[8 + k] * z + v[12 + k]);
    const scale = -eye[2];
    return [
      (0.5 + (0.5 * p[0] * eye[0]) / scale) * this.canvas.clientWidth,
      (0.5 - (0.5 * p[5] * eye[1]) / scale) * this.canvas.clientHeight,
      scale,
    ];
  }

  /** Return the nearest point of the skin [mm] under a point of the canvas [CSS pixels], or null. */
  pick(x, y) {
    const [v, p] = [this.view, this.projection];
    const { clientWidth, clientHeight } = this.canvas;
    const eye = [(2 * x) / clientWidth - 1, 1 - (2 * y) / clientHeight, -1];
    eye[0] /= p[0];
    eye[1] /= p[5];
    // The view's rotation is orthonormal: its transpose maps a ray to the rig's space.
    const turn = (a) => [0, 1, 2].map((k) => v[4 * k] * a[0] + v[4 * k + 1] * a[1] + v[4 * k + 2] * a[2]);
    const from = turn([-v[12], -v[13], -v[14]]);
    const along = turn(eye);
    const reach = this.face.hit(from, along);
    return reach === null ? null : from.map((value, k) => value + reach * along[k]);
  }

  /**
   * Draw a pose, framed from the front, into a thumbnail.
   * @returns {ImageData} with transparent background
   */
  thumbnail(weights, width, height) {
    const { gl } = this;
    if (gl.isContextLost()) return new ImageData(width, height);
    const make = (samples) => {
      const frame = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      const buffers = [
        [gl.COLOR_ATTACHMENT0, gl.RGBA8],
        [gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24],
      ].map(([attachment, format]) => {
        const buffer = gl.createRenderbuffer();
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format, width, height);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer);
        return buffer;
      });
      const free = () => {
        gl.deleteFramebuffer(frame);
        for (const buffer of buffers) gl.deleteRenderbuffer(buffer);
      };
      return { frame, free };
    };
    const flat = make(0);
    const smooth = make(SAMPLES);
    const [held, view, projection] = [this.camera, this.view, this.projection];
    this.camera = new OrbitCamera(this.face.camera, this.face.size);
    this.posed = false;
    this.#pose(weights);
    this.view = this.camera.view();
    this.projection = this.camera.projection(width / height);
    this.#drawFace(width, height, 0);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, smooth.frame);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, flat.frame);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, flat.frame);
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    flat.free();
    smooth.free();
    [this.camera, this.view, this.projection] = [held, view, projection];
    this.posed = false;
    return upright(pixels, width, height);
  }

  /** Release the canvas and its WebGL context. */
  dispose() {
    cancelAnimationFrame(this.request);
    this.release();
    this.observer.disconnect();
    this.labels?.remove();
    for (const [name, listener] of Object.entries(this.listeners)) {
      this.canvas.removeEventListener(name, listener);
    }
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  #upload() {
    const { gl, face } = this;
    this.programs = {
      face: compile(gl, FACE_VERTEX, FACE_FRAGMENT),
      mark: compile(gl, MARK_VERTEX, MARK_FRAGMENT),
    };
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    const attribute = (slot, data, size, type, normalized, usage = gl.STATIC_DRAW) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, usage);
      gl.enableVertexAttribArray(slot);
      gl.vertexAttribPointer(slot, size, type, normalized, 0, 0);
      return buffer;
    };
    this.positions = attribute(0, face.positions, 3, gl.FLOAT, false, gl.DYNAMIC_DRAW);
    this.normals = attribute(1, face.normals, 3, gl.FLOAT, false, gl.DYNAMIC_DRAW);
    attribute(2, face.colors, 4, gl.UNSIGNED_BYTE, true);
    attribute(3, face.parts, 1, gl.UNSIGNED_BYTE, false);
    attribute(4, face.rest, 3, gl.FLOAT, false);
    attribute(6, face.bare, 1, gl.UNSIGNED_BYTE, true);
    const still = this.reach ?? new Uint8Array(face.pointCount);
    this.reaches = attribute(5, still, 1, gl.UNSIGNED_BYTE, true, gl.DYNAMIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, face.triangles, gl.STATIC_DRAW);
    this.markArray = gl.createVertexArray();
    gl.bindVertexArray(this.markArray);
    const none = new Float32Array(0);
    this.markPoints = attribute(0, none, 3, gl.FLOAT, false, gl.DYNAMIC_DRAW);
    this.markColors = attribute(1, none, 4, gl.FLOAT, false, gl.DYNAMIC_DRAW);
    gl.bindVertexArray(null);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    this.posed = false;
    this.reachChanged = true;
  }

  #pose(weights) {
    const { gl, face } = this;
    const fill = (buffer, data) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, data);
    };
    if (this.reachChanged) {
      fill(this.reaches, this.reach ?? new Uint8Array(face.pointCount));
      this.reachChanged = false;
    }
    if (this.posed) return;
    face.pose(weights);
    fill(this.positions, face.positions);
    fill(this.normals, face.normals);
    this.posed = true;
  }

  #drawFace(width, height, tint = 1) {
    const { gl } = this;
    const { program, uniforms } = this.programs.face;
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.disable(gl.BLEND);
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.view, false, this.view);
    gl.uniformMatrix4fv(uniforms.projection, false, this.projection);
    gl.uniform1f(uniforms.tint, tint);
    gl.uniform1i(uniforms.heat, this.heat && tint ? 1 : 0);
    if (this.heat) gl.uniform3fv(uniforms["ramp[0]"], this.heat.ramp.flat());
    const { bands } = this.face;
    gl.uniform1i(uniforms.bandCount, bands.length);
    if (bands.length) {
      gl.uniform3fv(uniforms["bandSpans[0]"], bands.flatMap(({ ends, edge }) => [...ends, edge]));
      gl.uniform3fv(uniforms["bandColors[0]"], bands.flatMap(({ color }) => color));
      gl.uniform4fv(uniforms["bandRows[0]"], bands.flatMap(({ rows }) => rows));
    }
    gl.bindVertexArray(this.array);
    gl.drawElements(gl.TRIANGLES, this.face.triangles.length, gl.UNSIGNED_INT, 0);
  }

  /** Draw two poses: on either side of a line, or the first over the second. The first is posed last. */
  #drawCompared(width, height) {
    const { gl } = this;
    const { weights, how, share } = this.compared;
    const line = Math.round(share * width);
    const pose = (each) => {
      this.posed = false;
      this.#pose(each);
    };
    pose(weights);
    gl.enable(gl.SCISSOR_TEST);
    if (how === "wipe") gl.scissor(line, 0, width - line, height);
    else gl.scissor(0, 0, width, height);
    this.#drawFace(width, height, 0);
    pose(this.weights);
    if (how === "wipe") {
      gl.scissor(0, 0, line, height);
      this.#drawFace(width, height);
    } else {
      // Depth first, so that only the nearest surface is blended.
      gl.colorMask(false, false, false, false);
      this.#drawFace(width, height);
      gl.colorMask(true, true, true, true);
      gl.depthFunc(gl.EQUAL);
      gl.enable(gl.BLEND);
      gl.blendColor(0, 0, 0, share);
      gl.blendFuncSeparate(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA, gl.ONE, gl.ZERO);
      gl.drawElements(gl.TRIANGLES, this.face.triangles.length, gl.UNSIGNED_INT, 0);
      gl.disable(gl.BLEND);
      gl.depthFunc(gl.LEQUAL);
    }
    gl.disable(gl.SCISSOR_TEST);
  }

  /** Draw markers and lines, opaque before the skin and faint behind it. */
  #drawMarks(ratio) {
    const { gl, marks } = this;
    const { program, uniforms } = this.programs.mark;
    const count = marks.points.length / 3;
    const colors = new Float32Array(4 * count).fill(1);
    for (let i = 0; marks.colors && i < count; i++) {
      colors.set(marks.colors.subarray(3 * i, 3 * i + 3), 4 * i);
    }
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.view, false, this.view);
    gl.uniformMatrix4fv(uniforms.projection, false, this.projection);
    gl.uniform1f(uniforms.diameter, marks.diameter * ratio);
    gl.bindVertexArray(this.markArray);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    const lines = marks.targets ? between(marks.points, marks.targets, colors) : null;
    const rows = marks.lines?.length ? joined(marks.points, marks.lines) : null;
    for (const [test, opacity] of [[gl.GREATER, 0.12], [gl.LEQUAL, 1]]) {
      gl.depthFunc(test);
      gl.uniform1f(uniforms.opacity, opacity);
      if (rows) this.#drawSet(gl.LINES, rows.points, rows.colors, uniforms, false);
      if (lines) this.#drawSet(gl.LINES, lines.points, lines.colors, uniforms, false);
      this.#drawSet(gl.POINTS, marks.points, colors, uniforms, true);
    }
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
  }

  #drawSet(mode, points, colors, uniforms, round) {
    const { gl } = this;
    gl.uniform1i(uniforms.round_, round ? 1 : 0);
    for (const [buffer, data] of [[this.markPoints, points], [this.markColors, colors]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
    }
    gl.drawArrays(mode, 0, points.length / 3);
  }
}

const ROW = [0.08, 0.32, 0.62, 0.9]; // r g b and opacity, visible on skin

/** Vertices of lines between markers, by their indices. */
function joined(points, lines) {
  const out = { points: new Float32Array(3 * lines.length), colors: new Float32Array(4 * lines.length) };
  for (let i = 0; i < lines.length; i++) {
    out.points.set(points.subarray(3 * lines[i], 3 * lines[i] + 3), 3 * i);
    out.colors.set(ROW, 4 * i);
  }
  return out;
}

/** Vertices of lines from points to targets. */
function between(points, targets, colors) {
  const count = points.length / 3;
  const out = { points: new Float32Array(6 * count), colors: new Float32Array(8 * count) };
  for (let i = 0; i < count; i++) {
    out.points.set(points.subarray(3 * i, 3 * i + 3), 6 * i);
    out.points.set(targets.subarray(3 * i, 3 * i + 3), 6 * i + 3);
    for (const end of [0, 4]) out.colors.set(colors.subarray(4 * i, 4 * i + 4), 8 * i + end);
  }
  return out;
}

/** Convert WebGL's pixels (bottom row first, premultiplied) to an ImageData. */
function upright(pixels, width, height) {
  const image = new ImageData(width, height);
  for (let row = 0; row < height; row++) {
    const from = 4 * width * (height - 1 - row);
    image.data.set(pixels.subarray(from, from + 4 * width), 4 * width * row);
  }
  const { data } = image;
  for (let i = 0; i < data.length; i += 4) {
    const alpha = data[i + 3] / 255 || 1;
    for (let k = 0; k < 3; k++) data[i + k] /= alpha;
  }
  return image;
}
