// Plots over time: ruler, zoom, strips, legend, and sorted rows of curves.

import { node } from "./elements.js";
import { NOTHING, announce, byId, count, data } from "./report_page.js";

const COLUMNS = 1200; // most points of a line, for a wide screen
const LEAST_SPAN = 12; // pictures at the largest zoom
const TICK_PX = 90;
const LEAST_MOTION = 0.01; // range of a shape's weight from which it counts as moving

/** A strip's value at a picture as text. */
export function stripValue({ unit, values }, picture, unknown) {
  const value = values[picture];
  return value === null ? unknown : unit === "%" ? `${Math.round(value)}%` : value.toFixed(2);
}

/** Path of a line through values; with many values, through minimum and maximum of each column. */
function line(value, low, high, [from, to], fill = false) {
  const [begin, end] = [Math.max(0, Math.floor(from) - 1), Math.min(count, Math.ceil(to) + 2)];
  const step = Math.max(1, Math.ceil((end - begin) / COLUMNS));
  const y = (v) => (1 - (Math.min(Math.max(v, low), high) - low) / (high - low)).toFixed(4);
  let path = "", open = false, first = begin, last = begin;
  for (let start = begin; start < end; start += step) {
    let least = Infinity, most = -Infinity;
    for (let i = start; i < Math.min(start + step, end); i++) {
      const v = value(i);
      if (v === null) continue;
      if (v < least) least = v;
      if (v > most) most = v;
    }
    if (most === -Infinity) { open = false; continue; }
    if (!open) { if (!path) first = start; path += `M${start} ${y(least)}`; open = true; }
    path += least === most ? `L${start} ${y(most)}` : `L${start} ${y(least)}L${start} ${y(most)}`;
    last = start;
  }
  return fill && path ? `${path}L${last} 1L${first} 1Z` : path;
}

/** Class of a line: dots if no two values are neighbours, as of keys. */
function dotted(value) {
  for (let i = 1; i < count; i++) if (value(i) !== null && value(i - 1) !== null) return "";
  return " dots";
}

/** Emits `seek` (detail: picture) and `range` (detail: [first, last]) when a plot is dragged. */
export class Curves extends EventTarget {
  constructor(curves) {
    super();
    this.curves = curves;
    this.window = [0, Math.max(count - 1, 1)];
    this.plots = []; // {svg, lines: [{path, value, low, high, fill}], stale}
    this.figures = [];
    this.shownCurve = 0;
    this.picture = 0;
    this.#fillRuler();
    this.#fillStrips();
    this.#fillLegend();
    this.#fillRows();
    new ResizeObserver(() => this.#ticks()).observe(byId("ruler"));
  }

  /** Weight of a shape in a set of curves at a picture; null if missing. */
  weight(curve, shape, picture) {
    const step = this.curves[curve].values[shape * count + picture];
    return step === NOTHING ? null : step / data.steps;
  }

  /** Move the cursor to a picture and show the values there. */
  show(picture, curve) {
    this.picture = picture;
    this.shownCurve = curve;
    const [from, to] = this.window;
    if (picture < from || picture > to) this.zoomTo(picture - (to - from) / 10, picture + (0.9 * (to - from)));
    this.#place();
    for (const { values, into } of this.figures) into.textContent = values(picture);
    byId("numbers").textContent = `numbers: ${data.curves[curve].name}`;
  }

  /** Show a range of time, limited to the take. */
  zoomTo(from, to) {
    const whole = Math.max(count - 1, 1);
    const span = Math.min(Math.max(to - from, Math.min(LEAST_SPAN, whole)), whole);
    const start = Math.min(Math.max((from + to - span) / 2, 0), whole - span);
    this.window = [start, start + span];
    for (const plot of this.plots) {
      plot.svg.setAttribute("viewBox", `${start} 0 ${span} 1`);
      plot.stale = true;
    }
    byId("all").disabled = span >= whole;
    this.#ticks();
    this.#place();
    cancelAnimationFrame(this.redraw);
    this.redraw = requestAnimationFrame(() => this.#drawSeen());
  }

  zoomAll() {
    this.zoomTo(0, count);
  }

  /** Zoom around a picture; factors below 1 zoom in. */
  zoom(factor, about = this.picture) {
    const [from, to] = this.window;
    this.zoomTo(about - (about - from) * factor, about + (to - about) * factor);
  }

  pan(share) {
    const [from, to] = this.window;
    const shift = Math.min(Math.max(share * (to - from), -from), Math.max(count - 1, 1) - to);
    this.zoomTo(from + shift, to + shift);
  }

  /** Mark the looped range; null for none. */
  mark(range) {
    this.range = range;
    this.#place();
  }

  /** Sort the rows by region, name, motion or error. */
  sort(order) {
    const rows = this.rows.filter(({ head }) => !head);
    const rank = {
      region: (a, b) => data.regions[a.shape].localeCompare(data.regions[b.shape]) || a.shape - b.shape,
      name: (a, b) => a.name.localeCompare(b.name),
      motion: (a, b) => b.motion - a.motion,
      error: (a, b) => this.#error(b) - this.#error(a),
    }[order];
    rows.sort(rank);
    this.rows = [];
    let region = null;
    for (const row of rows) {
      if (order === "region" && data.regions[row.shape] !== region) {
        region = data.regions[row.shape];
        this.rows.push({ head: true, row: node("div", { class: "region" }, region) });
      }
      this.rows.push(row);
    }
    byId("rows").replaceChildren(...this.rows.map(({ row }) => row));
    for (const row of rows) row.small.textContent = order === "error" ? this.#error(row).toFixed(3) : "";
    this.filter();
  }

  /** Show the shapes that match the search; shapes at rest only if chosen. */
  filter() {
    const wanted = byId("find").value.trim().toLowerCase(), quiet = byId("quiet").checked;
    let head = null, any = false;
    for (const each of [...this.rows, { head: true }]) {
      if (each.head) {
        if (head) head.hidden = !any;
        head = each.row ?? null;
        any = false;
        continue;
      }
      const moves = each.motion > LEAST_MOTION;
      each.row.hidden = !(each.name.toLowerCase().includes(wanted) && (moves || quiet || wanted));
      any ||= !each.row.hidden;
    }
    const shown = this.rows.filter(({ head: is, row }) => !is && !row.hidden);
    byId("empty").hidden = shown.length > 0;
    this.#tabTo(shown.find((each) => each.row.tabIndex === 0) ?? shown[0]);
  }

  /** Draw all rows that are not hidden, for printing. */
  drawAll() {
    for (const each of this.rows) if (!each.head && !each.row.hidden) this.#drawRow(each);
    for (const plot of this.plots) this.#draw(plot);
  }

  /** Mean absolute difference of a shape's weight from the compared curves. */
  #error(row) {
    if (row.error === undefined) {
      const [ours, other] = [this.curves[0], this.curves[data.compared]];
      let sum = 0, known = 0;
      for (let i = row.shape * count; other && i < (row.shape + 1) * count; i++) {
        if (other.values[i] === NOTHING || ours.values[i] === NOTHING) continue;
        sum += Math.abs(ours.values[i] - other.values[i]);
        known++;
      }
      row.error = known ? sum / known / data.steps : 0;
    }
    return row.error;
  }

  #place() {
    const [from, to] = this.window;
    const style = document.documentElement.style;
    style.setProperty("--at", (this.picture - from) / (to - from));
    const [first, last] = this.range ?? [0, -1];
    style.setProperty("--first", this.range ? (first - from) / (to - from) : 0);
    style.setProperty("--last", this.range ? (last - from) / (to - from) : 0);
  }

  #plot(lines, low, high) {
    const [from, to] = this.window;
    const svg = node("svg", { viewBox: `${from} 0 ${to - from} 1`, preserveAspectRatio: "none", "aria-hidden": "true" });
    if (low < 0 && high > 0) {
      const zero = (high / (high - low)).toFixed(4);
      svg.append(node("path", { class: "zero", d: `M0 ${zero}L${count - 1} ${zero}` }));
    }
    const made = { svg, low, high, stale: true, lines };
    for (const each of lines) svg.append(each.path);
    this.plots.push(made);
    made.box = node("div", { class: "plot" }, svg);
    this.#steer(made.box);
    this.#draw(made);
    return made;
  }

  #draw(plot) {
    if (!plot.stale) return;
    plot.stale = false;
    for (const { path, value, fill } of plot.lines) {
      path.setAttribute("d", line(value, plot.low, plot.high, this.window, fill));
    }
  }

  #drawSeen() {
    const edge = innerHeight + 400;
    for (const plot of this.plots) {
      const box = plot.box.getBoundingClientRect();
      if (box.height && box.bottom > -400 && box.top < edge) this.#draw(plot);
    }
  }

  #pictureAt(box, clientX) {
    const { left, width } = box.getBoundingClientRect();
    const [from, to] = this.window;
    return from + ((clientX - left) / width) * (to - from);
  }

  /** Drag to scrub, with Shift to choose a range; Ctrl and the wheel zoom, Shift and the wheel pan. */
  #steer(box) {
    let start = null;
    const drag = (event) => {
      const at = this.#pictureAt(box, event.clientX);
      if (start !== null) {
        const range = [start, at].map(Math.round).sort((a, b) => a - b);
        if (range[1] > range[0]) this.dispatchEvent(new CustomEvent("range", { detail: range }));
      } else this.dispatchEvent(new CustomEvent("seek", { detail: at }));
    };
    box.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      box.setPointerCapture(event.pointerId);
      start = event.shiftKey || box.id === "ruler" ? this.#pictureAt(box, event.clientX) : null;
      if (box.id === "ruler") this.dispatchEvent(new CustomEvent("seek", { detail: start }));
      drag(event);
    });
    box.addEventListener("pointermove", (event) => { if (event.buttons & 1) drag(event); });
    box.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey && !event.shiftKey) return; // the page scrolls
      event.preventDefault();
      const by = event.deltaY || event.deltaX;
      if (event.shiftKey) this.pan(0.001 * by);
      else this.zoom(Math.exp(0.002 * by), this.#pictureAt(box, event.clientX));
    }, { passive: false });
  }

  #fillRuler() {
    this.#steer(byId("ruler"));
    byId("all").addEventListener("click", () => this.zoomAll());
    byId("closer").addEventListener("click", () => this.zoom(0.5));
    byId("farther").addEventListener("click", () => this.zoom(2));
    byId("all").disabled = true;
  }

  #ticks() {
    const ruler = byId("ruler");
    const [from, to] = this.window;
    const wanted = ((to - from) * TICK_PX) / Math.max(ruler.clientWidth, TICK_PX);
    const ten = 10 ** Math.floor(Math.log10(Math.max(wanted, 1)));
    const step = Math.max([1, 2, 5, 10].map((each) => each * ten).find((each) => each >= wanted), 1);
    const ticks = [];
    const begin = Math.ceil((data.frames[0] + from) / step) * step;
    for (let frame = begin; frame <= data.frames[0] + to; frame += step) {
      const tick = node("i", {}, String(frame));
      tick.style.left = `${(100 * (frame - data.frames[0] - from)) / (to - from)}%`;
      ticks.push(tick);
    }
    ruler.replaceChildren(...ticks);
  }

  #fillStrips() {
    for (const strip of data.strips) {
      const value = (i) => strip.values[i];
      const dots = dotted(value);
      const lines = (dots ? [false] : [true, false]).map((fill) => ({ fill, value, path: node("path", { class: `${fill ? "fill " : ""}strip-${strip.name}${dots}` }) }));
      const plot = this.#plot(lines, strip.low, strip.high);
      const into = node("span", { class: "value" });
      const scale = strip.unit === "%" ? "0–100%" : `${strip.low.toFixed(0)}–${strip.high.toPrecision(2)} ${strip.unit}`;
      byId("strips").append(node("div", { class: "strip" }, node("span", { class: "name" }, `${strip.name} `, node("small", {}, scale)), plot.box, into));
      this.figures.push({ into, values: (i) => stripValue(strip, i, "–") });
    }
  }

  #fillLegend() {
    for (const [index, { name, kind }] of data.curves.entries()) {
      const sample = node("svg", { viewBox: "0 0 10 2", preserveAspectRatio: "none", "aria-hidden": "true" }, node("path", { class: `k-${kind}`, d: "M0 1L10 1" }));
      const toggle = node("button", { type: "button", "aria-pressed": "true", title: `Show or hide the curves of ${name}` }, sample, name);
      toggle.addEventListener("click", () => {
        const hidden = byId("rows").classList.toggle(`off${index}`);
        toggle.setAttribute("aria-pressed", String(!hidden));
      });
      byId("legend").append(node("li", {}, toggle));
    }
    byId("find").addEventListener("input", () => this.filter());
    byId("quiet").addEventListener("change", () => this.filter());
    const error = data.curves[data.compared];
    if (error) byId("order").append(node("option", { value: "error" }, `difference from ${error.name}`));
    byId("order").addEventListener("change", (event) => this.sort(event.target.value));
  }

  #fillRows() {
    this.rows = data.shapes.map((name, shape) => {
      const small = node("small");
      const label = node("span", { class: "name", title: name }, name, " ", small);
      const row = node("div", { class: "curve", "data-shape": name, role: "img", tabindex: "-1" }, label);
      let motion = 0;
      for (const { values } of this.curves.slice(0, 2)) {
        for (let i = 0; i < count; i++) {
          const step = values[shape * count + i];
          if (step !== NOTHING) motion = Math.max(motion, Math.abs(step) / data.steps);
        }
      }
      return { row, small, shape, name, motion, drawn: null };
    });
    const seen = new IntersectionObserver((entries) => {
      for (const { isIntersecting, target } of entries) {
        if (isIntersecting) this.#drawRow(this.rows.find(({ row }) => row === target));
      }
    }, { rootMargin: "400px" });
    for (const { row } of this.rows) seen.observe(row);
    byId("rows").addEventListener("keydown", (event) => this.#keys(event));
    byId("rows").addEventListener("focusin", (event) => this.#read(event.target));
    this.sort("region");
  }

  #drawRow(entry) {
    if (entry.drawn) { this.#draw(entry.drawn); return; }
    let low = 0, high = 1;
    for (const { values } of this.curves) {
      for (let i = entry.shape * count; i < (entry.shape + 1) * count; i++) {
        if (values[i] === NOTHING) continue;
        low = Math.min(low, values[i] / data.steps);
        high = Math.max(high, values[i] / data.steps);
      }
    }
    const lines = data.curves.map(({ kind }, index) => {
      const value = (i) => this.weight(index, entry.shape, i);
      return { value, path: node("path", { class: `k-${kind} c${index}${dotted(value)}` }) };
    });
    entry.drawn = this.#plot(lines.reverse(), low, high); // the first on top
    const into = node("span", { class: "value" });
    entry.row.append(entry.drawn.box, into);
    const values = (i) => this.weight(this.shownCurve, entry.shape, i)?.toFixed(3) ?? "–";
    this.figures.push({ into, values });
    into.textContent = values(this.picture);
  }

  /** Make one row the stop of the Tab key; arrows move from there. */
  #tabTo(entry) {
    for (const each of this.rows) if (!each.head) each.row.tabIndex = each === entry ? 0 : -1;
  }

  #keys(event) {
    const way = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!way || event.target.tagName !== "DIV") return;
    event.preventDefault();
    const shown = this.rows.filter(({ head, row }) => !head && !row.hidden);
    const next = shown[shown.findIndex(({ row }) => row === event.target) + way];
    if (!next) return;
    this.#tabTo(next);
    next.row.focus();
    next.row.scrollIntoView({ block: "nearest" });
  }

  #read(row) {
    const entry = this.rows.find((each) => each.row === row);
    if (!entry) return;
    const value = this.weight(this.shownCurve, entry.shape, this.picture)?.toFixed(2) ?? "nothing";
    row.setAttribute("aria-label", `${entry.name}, ${data.curves[this.shownCurve].name} ${value} at frame ${data.frames[this.picture]}`);
    announce(row.getAttribute("aria-label"));
  }
}
