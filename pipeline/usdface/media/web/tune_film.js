// Strip of all pairs: thumbnail, number and state of each.

import { node } from "./elements.js";

const [WIDTH, HEIGHT] = [76, 78];
const SETTLE_MS = 350;
const OFF_MM = 1;

export class FilmStrip {
  /**
   * @param {HTMLElement} root
   * @param {TuneState} state
   * @param {(pair: number) => void} onPick
   */
  constructor(root, state, onPick) {
    this.root = root;
    this.state = state;
    this.stale = new Set();
    this.seen = new Set();
    this.draw = null;
    this.tiles = state.pairs.map((pair, index) => this.#tile(pair, index, onPick));
    root.append(...this.tiles.map((tile) => tile.element));
    const watcher = new IntersectionObserver(
      (entries) => {
        for (const { target, isIntersecting } of entries) {
          this.seen[isIntersecting ? "add" : "delete"](Number(target.dataset.pair));
        }
        this.#later();
      },
      { root, rootMargin: "0px 300px" },
    );
    this.tiles.forEach(({ element }, index) => {
      this.stale.add(index);
      watcher.observe(element);
    });
    root.addEventListener(
      "wheel",
      (event) => {
        if (event.deltaX || !event.deltaY) return;
        event.preventDefault();
        root.scrollLeft += event.deltaY;
      },
      { passive: false },
    );
    state.addEventListener("weights", ({ detail: { pair } }) => {
      this.paint([pair]);
      this.stale.add(pair);
      clearTimeout(this.settling);
      this.settling = setTimeout(() => this.#later(), SETTLE_MS);
    });
    state.addEventListener("done", ({ detail: { pair } }) => this.paint([pair]));
    state.addEventListener("pair", () => this.#mark());
  }

  /** Add filters by residual to a menu; `residual(pair)` returns distances by part [mm]. */
  measure(residual, parts, menu) {
    this.residual = residual;
    const words = (part) => `proposals, ${part || "residual"} over ${OFF_MM} mm`;
    menu.append(...["", ...parts].map((part) => new Option(words(part), `off ${part}`)));
  }

  /** Start drawing thumbnails; `draw(pair, width, height)` returns ImageData. */
  start(draw) {
    this.draw = draw;
    this.#later();
  }

  /** Redraw all thumbnails. */
  refresh() {
    this.tiles.forEach((_, index) => this.stale.add(index));
    this.paint();
    this.#later();
  }

  paint(pairs = this.tiles.keys()) {
    for (const pair of pairs) {
      const { element, mark } = this.tiles[pair];
      const done = this.state.done[pair];
      const tuned = this.state.isTuned(pair);
      element.classList.toggle("done", done);
      element.classList.toggle("tuned", tuned);
      element.classList.toggle("sieved", !this.#wanted(pair));
      mark.title = done ? "done" : tuned ? "changed, not done" : "as proposed";
    }
  }

  /**
   * Show all pairs, or those `todo`, `done` or `noted`; or `off PART`, unchanged proposals with a
   * residual above `OFF_MM` of a part of the face, or without a part of the whole.
   */
  sieve(which) {
    this.which = which;
    this.paint();
  }

  #wanted(pair) {
    const done = this.state.done[pair], noted = this.state.pairs[pair].notes.length > 0;
    const part = /^off (.*)/.exec(this.which)?.[1];
    if (part !== undefined) return !this.state.isTuned(pair) && this.residual(pair).get(part) > OFF_MM;
    return { todo: !done, done, noted }[this.which] ?? true;
  }

  #tile(pair, index, onPick) {
    const facts = [`pair ${index + 1}`, `frame ${pair.frame}`, pair.take, pair.viseme, pair.emotion, ...pair.notes];
    const ratio = 2; // supersampled
    const canvas = node("canvas", { width: WIDTH * ratio, height: HEIGHT * ratio });
    const mark = node("span", { class: "mark" });
    const what = node("span", { class: "what" }, node("b", {}, index + 1), node("span", {}, pair.viseme || ""), mark);
    const element = node("button", {
      class: pair.notes.length ? "tile noted" : "tile",
      title: facts.filter(Boolean).join(" · "),
      tabindex: -1,
      "data-pair": index,
    }, canvas, what);
    element.addEventListener("click", () => onPick(index));
    return { element, canvas, mark };
  }

  #mark() {
    this.tiles.forEach(({ element }, index) => {
      if (index === this.state.current) {
        element.setAttribute("aria-current", "true");
        element.scrollIntoView({ block: "nearest", inline: "nearest" });
      } else element.removeAttribute("aria-current");
    });
  }

  /** Draw thumbnails one by one while the browser is idle. */
  #later() {
    if (this.waiting || !this.draw) return;
    const pair = [...this.seen].find((each) => this.stale.has(each));
    if (pair === undefined) return;
    this.waiting = true;
    const work = () => {
      this.waiting = false;
      const { canvas } = this.tiles[pair];
      canvas.getContext("2d").putImageData(this.draw(pair, canvas.width, canvas.height), 0, 0);
      this.stale.delete(pair);
      this.#later();
    };
    if (globalThis.requestIdleCallback) requestIdleCallback(work, { timeout: 2000 });
    else setTimeout(work, 30);
  }
}
