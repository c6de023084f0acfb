// Panel with a slider and a number per shape, grouped by part of the face.

import { button, node } from "./elements.js";
import { oneTabStop } from "./tab_stops.js";

const ORDER = ["brows", "lids", "cheeks and nose", "mouth", "jaw", ""];
const TITLES = { "": "other" };
const ACTIVE = 5e-4;

/** Order shapes so that each is followed by its mirror partner. */
function besides(shapes, mirror) {
  const out = [];
  for (const shape of shapes) {
    if (out.includes(shape)) continue;
    out.push(shape);
    const partner = mirror[shape];
    if (partner !== shape && shapes.includes(partner)) out.push(partner);
  }
  return out;
}

/** Whether a name contains the letters of each word in order: jw op matches jawOpen. */
function matches(name, query) {
  return query.split(/\s+/).every((word) => {
    let at = 0;
    return [...word].every((letter) => {
      at = name.indexOf(letter, at) + 1;
      return at > 0;
    });
  });
}

export class ShapePanel {
  /**
   * @param {HTMLElement} root
   * @param {TuneState} state
   * @param {string[]} regions of each shape
   * @param {(shape: number | null) => void} onHover
   * @param {{[label: string]: {title: string, act: (shapes: number[], part: string) => void}}} tools
   *   buttons of each part
   */
  constructor(root, state, regions, onHover, tools) {
    this.root = root;
    this.tools = {
      ...tools,
      Reset: {
        title: "This part back to the proposal",
        act: (shapes) => state.reset(shapes.filter((shape) => state.differs(shape))),
      },
    };
    this.state = state;
    this.rows = [];
    this.groups = [];
    this.filter = "all";
    this.query = "";
    for (const region of ORDER) {
      const own = state.names.map((_, k) => k).filter((k) => (regions[k] || "") === region);
      if (own.length) this.#group(region, besides(own, state.mirror));
    }
    this.none = node("p", { class: "none", hidden: "" });
    root.append(this.none);
    root.addEventListener("pointerover", (event) => {
      const row = event.target.closest?.(".label")?.closest(".shape");
      onHover(row ? Number(row.dataset.shape) : null);
    });
    root.addEventListener("pointerleave", () => onHover(null));
    state.addEventListener("weights", ({ detail: { pair, shapes } }) => {
      if (pair === state.current) this.paint(shapes);
    });
    state.addEventListener("pair", () => this.paint());
  }

  /** Show or hide a tool of all parts. */
  offer(label, on) {
    for (const button of this.root.querySelectorAll(`[data-tool="${label}"]`)) button.hidden = !on;
  }

  show(filter) {
    this.filter = filter;
    this.#sieve();
  }

  find(query) {
    this.query = query.trim().toLowerCase();
    this.#sieve();
  }

  /** Focus the first visible slider. */
  enter() {
    const first = this.rows.find(({ element, group }) => !element.hidden && !group.details.hidden);
    first?.range.focus();
    first?.element.scrollIntoView({ block: "nearest" });
  }

  /** Update rows from the weights. */
  paint(shapes = this.state.names.keys()) {
    for (const shape of shapes) this.#paintRow(this.rows[shape]);
    for (const group of this.groups) this.#count(group);
    if (this.filter !== "all" && !this.root.contains(document.activeElement)) this.#sieve();
  }

  #group(region, shapes) {
    const title = TITLES[region] ?? region;
    const count = node("span", { class: "count" });
    const buttons = Object.entries(this.tools).map(([label, { title: hint, act }]) => {
      const made = button(label, hint, (event) => {
        event.preventDefault(); // the summary stays open
        act(shapes, title);
      });
      made.dataset.tool = label;
      return made;
    });
    const summary = node("summary", {}, node("span", {}, title), count, ...buttons);
    const details = node("details", { open: "" }, summary);
    const group = { region, details, shapes, count, reset: buttons.at(-1) };
    for (const shape of shapes) details.append(this.#row(shape, group));
    this.groups.push(group);
    this.root.append(details);
    oneTabStop(details, "input[type=range]", this.root);
  }

  #row(shape, group) {
    const { state } = this;
    const name = state.names[shape];
    const both = { min: state.low[shape], max: state.high[shape], "aria-label": name };
    const range = node("input", { type: "range", step: 0.001, ...both });
    const number = node("input", { type: "number", step: 0.01, tabindex: -1, ...both }); // reached by Enter
    const slide = node("span", { class: "slide" }, range);
    const element = node(
      "div",
      { class: state.mirror[shape] >= shape ? "shape first" : "shape", "data-shape": shape },
      node("span", { class: "dot" }), node("span", { class: "label" }, name), slide, number,
    );
    let back = null;
    range.addEventListener("input", () => state.slide(shape, range.valueAsNumber));
    range.addEventListener("change", () => state.endGesture());
    range.addEventListener("keydown", (event) => this.#keys(event, shape));
    number.addEventListener("change", () => {
      if (number.value !== "") state.slide(shape, number.valueAsNumber);
      state.endGesture();
      this.#paintRow(this.rows[shape]);
    });
    number.addEventListener("focus", ({ relatedTarget }) => {
      back = relatedTarget === range ? range : null;
      number.select();
    });
    number.addEventListener("blur", () => this.#paintRow(this.rows[shape]));
    number.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== "Escape") return;
      const slider = back;
      number.blur();
      slider?.focus();
    });
    element.addEventListener("dblclick", (event) => {
      if (event.target !== number) state.resetShape(shape);
    });
    this.rows[shape] = { shape, element, slide, range, number, group };
    return element;
  }

  #keys(event, shape) {
    const steps = { ArrowLeft: -1, ArrowRight: 1 };
    if (event.key === "Delete" || event.key === "Backspace") this.state.resetShape(shape);
    else if (event.key === "Enter") this.rows[shape].number.focus();
    else if (event.key in steps && !event.ctrlKey && !event.metaKey && !event.altKey) {
      const step = steps[event.key] * (event.shiftKey ? 0.1 : 0.01);
      this.state.slide(shape, this.state.row()[shape] + step);
    } else return;
    event.preventDefault();
    event.stopPropagation();
  }

  #paintRow({ shape, element, slide, range, number }) {
    const { state } = this;
    const value = state.row()[shape];
    const [low, high] = [state.low[shape], state.high[shape]];
    const at = (x) => `${(100 * Math.max(0, Math.min(1, (x - low) / (high - low)))).toFixed(2)}%`;
    slide.style.setProperty("--from", at(Math.min(0, value)));
    slide.style.setProperty("--to", at(Math.max(0, value)));
    slide.style.setProperty("--tick", at(state.proposal()[shape]));
    if (Number(range.value) !== value) range.value = value;
    if (document.activeElement !== number) number.value = (value + 0).toFixed(3);
    element.classList.toggle("active", Math.abs(value) > ACTIVE);
    element.classList.toggle("changed", state.differs(shape));
  }

  #count({ shapes, count, reset }) {
    const changed = shapes.filter((shape) => this.state.differs(shape)).length;
    count.textContent = changed ? `${changed} changed` : "";
    reset.hidden = !changed;
  }

  #sieve() {
    const { state } = this;
    let any = false;
    for (const { details, shapes } of this.groups) {
      let some = false;
      for (const shape of shapes) {
        const { element } = this.rows[shape];
        const named = matches(state.names[shape].toLowerCase(), this.query);
        const wanted =
          this.filter === "all" ||
          (this.filter === "changed" && state.differs(shape)) ||
          (this.filter === "active" && Math.abs(state.row()[shape]) > ACTIVE);
        element.hidden = !(named && wanted);
        some ||= !element.hidden;
      }
      details.hidden = !some;
      if (this.query && some) details.open = true;
      any ||= some;
    }
    this.none.hidden = any;
    this.none.textContent = this.query ? "no such shape" : `no shape is ${this.filter}`;
  }
}
