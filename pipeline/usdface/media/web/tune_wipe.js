// Wipe between video and face, with the face turned like the performer's head.

import { steerPicture } from "./tune_video.js";

const STEP = 0.02;

export class Wipe {
  /**
   * @param {HTMLElement} picture contains the pair's image, over the face
   * @param {HTMLElement} line draggable, and a slider for the keyboard
   */
  constructor(picture, line) {
    Object.assign(this, { picture, line, on: false });
    this.fit = steerPicture(picture, picture.querySelector("img"), { loose: true });
    line.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      line.focus();
      line.setPointerCapture(event.pointerId);
    });
    line.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      const box = picture.parentElement.getBoundingClientRect();
      this.move((event.clientX - box.left) / box.width);
    });
    line.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!way) return;
      event.preventDefault();
      event.stopPropagation();
      this.move(this.share + way * STEP);
    });
    this.move(0.5);
  }

  /** Move the line to a share of the width; video on its left, the face on its right. */
  move(share) {
    this.share = Math.max(0, Math.min(1, share));
    const percent = 100 * this.share;
    this.line.style.left = `${percent}%`;
    this.line.setAttribute("aria-valuenow", Math.round(percent));
    this.picture.style.clipPath = `inset(0 ${100 - percent}% 0 0)`;
  }

  show(on) {
    this.on = on;
    this.picture.hidden = this.line.hidden = !on;
  }
}
