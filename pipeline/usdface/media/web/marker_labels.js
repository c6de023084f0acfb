// Names of markers, drawn on a 2-D canvas over the face.

const FONT = '10px ui-monospace, "SF Mono", Menlo, Consolas, "DejaVu Sans Mono", monospace';

const HALF_LINE = 6;

/** A text layer over a viewer's canvas. */
export class MarkerLabels {
  constructor(canvas) {
    this.over = canvas;
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("aria-hidden", "true");
    Object.assign(this.canvas.style, { position: "absolute", pointerEvents: "none" });
    canvas.after(this.canvas);
  }

  /** Draw the names of markers on the near side of the head. */
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
    const taken = [];
    marks.names
      .map((name, i) => [name, viewer.project(...marks.points.subarray(3 * i, 3 * i + 3))])
      .sort((a, b) => a[1][2] - b[1][2]) // the nearest first
      .forEach(([name, [x, y, depth]]) => {
        if (depth > middle) return;
        const box = [x + 6, y - HALF_LINE, x + 9 + pen.measureText(name).width, y + HALF_LINE];
        const hit = (b) => box[0] < b[2] && b[0] < box[2] && box[1] < b[3] && b[1] < box[3];
        if (taken.some(hit)) return;
        taken.push(box);
        pen.strokeText(name, x + 7, y);
        pen.fillText(name, x + 7, y);
      });
  }

  remove() {
    this.canvas.remove();
  }
}
