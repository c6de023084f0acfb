// A portrait camera that orbits a face: mouse, touch and keyboard.

const STEP = Math.PI / 36;

/** A camera by angles, distance and target [mm, radians]. */
export class OrbitCamera {
  /**
   * @param {{target: number[], distance: number, fov: number, framedWidth: number, yaw?: number,
   *   pitch?: number}} home initial view, which frames the face.
   * `roll` rotates the picture clockwise [radians].
   */
  constructor(home, size) {
    this.home = home;
    this.size = size;
    this.reset();
  }

  /** Frame the face from a direction, by default the initial one. */
  reset(yaw = this.home.yaw ?? 0, pitch = this.home.pitch ?? 0, roll = 0) {
    this.yaw = yaw;
    this.pitch = pitch;
    this.roll = roll;
    this.frame();
  }

  /** Frame the face from the current direction. */
  frame() {
    this.target = [...this.home.target];
    this.distance = this.home.distance;
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-1.5, Math.min(1.5, this.pitch + pitch));
  }

  zoom(factor) {
    const { distance } = this.home;
    this.distance = Math.max(0.15 * distance, Math.min(5 * distance, this.distance * factor));
  }

  /** Shift the target by shares of the picture's height. */
  pan(right, up) {
    const span = 2 * this.distance * Math.tan((this.home.fov * Math.PI) / 360);
    const view = this.view();
    for (let k = 0; k < 3; k++) {
      this.target[k] -= span * (right * view[4 * k] + up * view[4 * k + 1]);
    }
  }

  /** World to camera. */
  view() {
    const [cy, sy] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const [cp, sp] = [Math.cos(this.pitch), Math.sin(this.pitch)];
    // Rows: right, up, backward. Positive yaw shows the character's left, positive pitch the top.
    const [cr, sr] = [Math.cos(this.roll), Math.sin(this.roll)];
    const [right, up] = [[cy, 0, -sy], [-sy * sp, cp, -cy * sp]];
    const axes = [
      ...right.map((value, k) => cr * value + sr * up[k]),
      ...right.map((value, k) => cr * up[k] - sr * value),
      sy * cp, sp, cy * cp,
    ];
    const columns = [0, 1, 2].map((k) => [axes[k], axes[3 + k], axes[6 + k]]);
    const at = [0, 1, 2].map((row) =>
      -columns.reduce((total, column, k) => total + column[row] * this.target[k], 0),
    );
    at[2] -= this.distance;
    return new Float32Array([...columns.flatMap((column) => [...column, 0]), ...at, 1]);
  }

  /** Camera to picture; narrow pictures have a larger field of view, so that the face fits. */
  projection(aspect) {
    const half = Math.tan((this.home.fov * Math.PI) / 360) / Math.min(aspect / this.home.framedWidth, 1);
    const near = Math.max(this.distance - 4 * this.size, 0.05 * this.distance);
    const far = this.distance + 4 * this.size;
    const out = new Float32Array(16);
    out[0] = 1 / (half * aspect);
    out[5] = 1 / half;
    out[10] = (far + near) / (near - far);
    out[11] = -1;
    out[14] = (2 * far * near) / (near - far);
    return out;
  }
}

/**
 * Control a camera by a canvas. Drag turns (left) or shifts (middle, right, or with Shift), wheel
 * and two fingers zoom, double click frames; keyboard: arrows, Shift + arrows, + − F 0.
 * @returns {() => void} removes the listeners
 */
export function steer(canvas, camera, changed) {
  const fingers = new Map();
  const listeners = {
    pointerdown(event) {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.focus({ preventScroll: true });
      event.preventDefault();
    },
    pointermove(event) {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = [event.clientX, event.clientY];
      const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
      const height = canvas.clientHeight || 1;
      if (fingers.size === 2) {
        const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
        const apart = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]) || 1;
        camera.zoom(apart(before) / apart(now));
        camera.pan(dx / 2 / height, -dy / 2 / height);
      } else if (event.buttons & 6 || event.shiftKey) {
        camera.pan(dx / height, -dy / height);
      } else {
        camera.turn(-0.008 * dx, 0.008 * dy);
      }
      fingers.set(event.pointerId, now);
      changed();
    },
    pointerup: (event) => fingers.delete(event.pointerId),
    pointercancel: (event) => fingers.delete(event.pointerId),
    contextmenu: (event) => event.preventDefault(),
    wheel(event) {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 16 : 1;
      camera.zoom(Math.exp(0.0012 * lines * event.deltaY));
      changed();
    },
    dblclick() {
      camera.frame();
      changed();
    },
    keydown(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const move = event.shiftKey ? (x, y) => camera.pan(0.05 * x, 0.05 * y) : null;
      const go = move ?? ((x, y) => camera.turn(-STEP * x, -STEP * y));
      const actions = {
        ArrowLeft: () => go(-1, 0),
        ArrowRight: () => go(1, 0),
        ArrowUp: () => go(0, 1),
        ArrowDown: () => go(0, -1),
        "+": () => camera.zoom(0.9),
        "=": () => camera.zoom(0.9),
        "-": () => camera.zoom(1 / 0.9),
        f: () => camera.frame(),
        0: () => camera.reset(),
      };
      const action = actions[event.key] ?? actions[event.key.toLowerCase()];
      if (!action) return;
      event.preventDefault();
      event.stopPropagation();
      action();
      changed();
    },
  };
  for (const [name, listener] of Object.entries(listeners)) {
    canvas.addEventListener(name, listener, { passive: false });
  }
  return () => {
    for (const [name, listener] of Object.entries(listeners)) {
      canvas.removeEventListener(name, listener);
    }
  };
}
