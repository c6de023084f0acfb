// The pair's video frame with zoom and pan, and the second before and after it, with sound.

import { PairSound } from "./tune_sound.js";

const KEPT = 12;

export class VideoPane {
  /** @param {HTMLImageElement[]} images elements that show the picture; the first has zoom and pan */
  constructor(images, placeholder, note, after, button) {
    Object.assign(this, { images, placeholder, note, after, button });
    this.sound = new PairSound();
    after.addEventListener("input", async () => {
      this.stop();
      this.#scrub();
      if (await this.sound.load(this.pair)) this.sound.play(after.valueAsNumber);
    });
    button.addEventListener("click", () => this.play());
    this.found = new Map(); // pair → promise of {url} or {reason}
    this.fit = steerPicture(images[0].parentElement, images[0]);
  }

  /** Show a pair's picture, or the reason if there is none; neighbours are prefetched. */
  async show(pair, pairs) {
    this.stop();
    this.pair = pair;
    this.after.value = 0;
    const answer = await this.#fetch(pair, pairs);
    if (this.pair !== pair) return; // another pair has been chosen
    for (const image of this.images) image.hidden = !answer.url;
    this.placeholder.hidden = Boolean(answer.url);
    if (answer.url) this.#put(answer.url);
    else this.placeholder.textContent = `No picture: ${answer.reason}.`;
    this.name = answer.url ? `${pairs[pair].take}, frame ${pairs[pair].frame}` : "";
    this.note.textContent = this.name;
    this.after.hidden = this.button.hidden = !answer.url;
    for (const next of [pair + 1, pair - 1]) if (pairs[next]) this.#fetch(next, pairs);
  }

  /** Follow the slider; skips times that it has passed. */
  async #scrub() {
    if (this.scrubbing) return;
    this.scrubbing = true;
    for (let shown = null; shown !== this.after.valueAsNumber; ) {
      shown = this.after.valueAsNumber;
      const pair = this.pair;
      const { url, reason } = await get(pair, shown);
      if (this.pair !== pair) break;
      if (url) {
        this.#put(url);
        await Promise.allSettled(this.images.map((image) => image.decode()));
        URL.revokeObjectURL(url);
      }
      const when = shown ? ` ${shown > 0 ? "+" : "−"}${Math.abs(shown).toFixed(2)} s` : "";
      this.note.textContent = url ? this.name + when : reason;
    }
    this.scrubbing = false;
  }

  #put(url) {
    for (const image of this.images) image.src = url;
  }

  /** Play from the slider's position to its end, with sound, and return to the frame; or stop. */
  async play() {
    if (this.playing) return this.stop();
    const { after } = this;
    const [low, high] = [Number(after.min), Number(after.max)];
    const from = after.valueAsNumber === 0 || after.valueAsNumber >= high ? low : after.valueAsNumber;
    const mine = (this.playing = {});
    this.button.setAttribute("aria-pressed", true);
    const heard = await this.sound.load(this.pair);
    if (this.playing !== mine) return;
    if (heard) await this.sound.play(from, high - from);
    const begun = performance.now();
    const step = () => {
      if (this.playing !== mine) return;
      const now = from + (performance.now() - begun) / 1000;
      after.value = now < high ? now : 0;
      this.#scrub();
      if (now < high) requestAnimationFrame(step);
      else this.stop();
    };
    step();
  }

  stop() {
    this.playing = null;
    this.button.setAttribute("aria-pressed", false);
    this.sound.stop();
  }

  #fetch(pair, pairs) {
    if (!this.found.has(pair)) {
      const { noPicture } = pairs[pair];
      this.found.set(pair, noPicture ? Promise.resolve({ reason: noPicture }) : get(pair));
    }
    for (const [old, answer] of this.found) {
      if (this.found.size <= KEPT) break;
      if (Math.abs(old - this.pair) <= 1 || old === pair) continue;
      this.found.delete(old);
      answer.then(({ url }) => url && URL.revokeObjectURL(url));
    }
    return this.found.get(pair);
  }
}

/**
 * Zoom a picture by the wheel, shift it by dragging, and fit it by a double click.
 * @param {{loose?: boolean}} options `loose` permits shifts and sizes beyond the stage
 * @returns {() => void} fits the picture
 */
export function steerPicture(stage, image, { loose = false } = {}) {
  let zoom, shift;
  const place = () => {
    image.style.transform = `translate(${shift[0]}px, ${shift[1]}px) scale(${zoom})`;
  };
  const fit = () => {
    zoom = 1;
    shift = [0, 0];
    place();
  };
  const wheel = (event) => {
    event.preventDefault();
    const box = stage.getBoundingClientRect();
    const at = [event.clientX - box.left, event.clientY - box.top];
    const next = Math.max(loose ? 0.2 : 1, Math.min(12, zoom * Math.exp(-0.0015 * event.deltaY)));
    const fitted = next === 1 && !loose;
    shift = fitted ? [0, 0] : at.map((a, k) => a - ((a - shift[k]) * next) / zoom);
    zoom = next;
    place();
  };
  stage.addEventListener("wheel", wheel, { passive: false });
  stage.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    if (!event.buttons || (zoom === 1 && !loose)) return;
    shift = [shift[0] + event.movementX, shift[1] + event.movementY];
    place();
  });
  stage.addEventListener("dblclick", fit);
  fit();
  return fit;
}

async function get(pair, after = 0) {
  try {
    const response = await fetch(`/picture/${pair}.jpg${after ? `?after=${after}` : ""}`);
    if (response.ok) return { url: URL.createObjectURL(await response.blob()) };
    return { reason: (await response.json()).reason };
  } catch {
    return { reason: "the server does not answer" };
  }
}
