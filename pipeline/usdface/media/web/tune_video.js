// The pair's video frame: fetched as it is needed, zoomed and shifted to look at a mouth closely.

const KEPT = 12;

export class VideoPane {
  constructor(image, placeholder, note, after) {
    this.after = after;
    after.addEventListener("input", () => this.#scrub());
    this.image = image;
    this.placeholder = placeholder;
    this.note = note;
    this.found = new Map(); // pair → promise of {url} or {reason}
    this.fit();
    this.#steer(image.parentElement);
  }

  /** Show a pair's picture, or say why there is none; its neighbours are fetched ahead. */
  async show(pair, pairs) {
    this.pair = pair;
    this.after.value = 0;
    const answer = await this.#fetch(pair, pairs);
    if (this.pair !== pair) return; // the animator is further on
    this.image.hidden = !answer.url;
    this.placeholder.hidden = Boolean(answer.url);
    if (answer.url) this.image.src = answer.url;
    else this.placeholder.textContent = `No picture: ${answer.reason}.`;
    this.name = answer.url ? `${pairs[pair].take}, frame ${pairs[pair].frame}` : "";
    this.note.textContent = this.name;
    this.after.hidden = !answer.url;
    for (const next of [pair + 1, pair - 1]) if (pairs[next]) this.#fetch(next, pairs);
  }

  /** Follow the slider; moments that it has left meanwhile are not asked for. */
  async #scrub() {
    if (this.scrubbing) return;
    this.scrubbing = true;
    for (let shown = null; shown !== this.after.valueAsNumber; ) {
      shown = this.after.valueAsNumber;
      const pair = this.pair;
      const { url, reason } = await get(pair, shown);
      if (this.pair !== pair) break;
      if (url) this.image.src = url;
      this.image.addEventListener("load", () => url && URL.revokeObjectURL(url), { once: true });
      const when = shown ? ` ${shown > 0 ? "+" : "−"}${Math.abs(shown).toFixed(2)} s` : "";
      this.note.textContent = url ? this.name + when : reason;
    }
    this.scrubbing = false;
  }

  fit() {
    this.zoom = 1;
    this.shift = [0, 0];
    this.#place();
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

  #place() {
    const [x, y] = this.shift;
    this.image.style.transform = `translate(${x}px, ${y}px) scale(${this.zoom})`;
  }

  #steer(stage) {
    stage.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const box = stage.getBoundingClientRect();
        const at = [event.clientX - box.left, event.clientY - box.top];
        const zoom = Math.max(1, Math.min(12, this.zoom * Math.exp(-0.0015 * event.deltaY)));
        const scale = zoom / this.zoom;
        this.shift = zoom === 1 ? [0, 0] : at.map((a, k) => a - (a - this.shift[k]) * scale);
        this.zoom = zoom;
        this.#place();
      },
      { passive: false },
    );
    stage.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      stage.setPointerCapture(event.pointerId);
    });
    stage.addEventListener("pointermove", (event) => {
      if (!event.buttons || this.zoom === 1) return;
      this.shift = [this.shift[0] + event.movementX, this.shift[1] + event.movementY];
      this.#place();
    });
    stage.addEventListener("dblclick", () => this.fit());
  }
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
