// Names beside markers: text on a plain canvas that lies over the face and lets the mouse through.

const FONT = '10px ui-monospace, "SF Mono", Menlo, Consolas, "DejaVu Sans Mono", monospace';

/** A text layer over a viewer's canvas; made when first needed. */
export class MarkerLabels {
  constructor(canvas) {
    this.over = canvas;
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("aria-hidden", "true");
    Object.assign(this.canvas.style, { position: "absolute", pointerEvents: "none" });
    canvas.after(this.canvas);
  }

  /** Draw names; those whose marker is on the far side of the head are left out. */
  draw(viewer, ratio) {
    const { canvas, over } = this;
    Object.assign(canvas.style, {
      left: `${over.offsetLeft}px`,
      top: `${over.offsetTop}px`,
      width: `${over.clientWidth}px`,
      height: `${over.clientHeight}px`,
    });
    canvas.width = Math.round(over.clientWidth * ratio);
    canvas.height = Math.round(over.clientHeight * ratio);
    const pen = canvas.getContext("2d");
    const { marks } = viewer;
    if (!marks?.labels || !marks.names) return;
    pen.scale(ratio, ratio);
    pen.font = FONT;
    pen.textBaseline = "middle";
    pen.lineJoin = "round";
    pen.lineWidth = 3;
    pen.strokeStyle = "rgba(0, 0, 0, 0.75)";
    pen.fillStyle = "#e6e6e6";
    const middle = viewer.camera.distance;
    marks.names.forEach((name, i) => {
      const [x, y, depth] = viewer.project(...marks.points.subarray(3 * i, 3 * i + 3));
      if (depth > middle) return;
      pen.strokeText(name, x + 7, y);
      pen.fillText(name, x + 7, y);
    });
  }

  remove() {
    this.canvas.remove();
  }
}
