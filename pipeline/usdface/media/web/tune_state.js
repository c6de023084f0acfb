// State of the tuning page: weights, proposals, undo and redo.

const SAME = 1e-6; // as in usdface.tuning.session
const SEEN = 5e-4; // visible with three decimals

/** Emits `weights` (detail: pair, shapes), `done` (detail: pair) and `pair` (the current one). */
export class TuneState extends EventTarget {
  /**
   * @param {{names: string[], low: number[], high: number[], mirror: number[], sided: boolean[]}} shapes
   * @param {object[]} pairs descriptions of the pairs
   */
  constructor(shapes, pairs) {
    super();
    Object.assign(this, shapes);
    this.pairs = pairs;
    this.current = 0;
    this.linked = true;
    this.past = [];
    this.future = [];
    this.gesture = null;
    this.solved = new Map(); // pair → Map shape → value
  }

  /** Load the server's state. */
  load({ weights, proposals, done }) {
    this.weights = weights;
    this.proposals = proposals;
    this.done = done;
  }

  row(pair = this.current, of = this.weights) {
    const count = this.names.length;
    return of.subarray(pair * count, (pair + 1) * count);
  }

  proposal(pair = this.current) {
    return this.row(pair, this.proposals);
  }

  #away(shape, pair) {
    return Math.abs(this.row(pair)[shape] - this.proposal(pair)[shape]);
  }

  /** Whether a shape differs visibly from its proposal. */
  differs(shape, pair = this.current) {
    return this.#away(shape, pair) > SEEN;
  }

  /** Shapes of a pair that differ from the proposal. */
  changed(pair = this.current) {
    return this.names.map((_, shape) => shape).filter((shape) => this.#away(shape, pair) > SAME);
  }

  isTuned(pair) {
    return this.done[pair] || this.names.some((_, shape) => this.#away(shape, pair) > SAME);
  }

  /** Shapes set by hand: different from the proposal and from the last solve. */
  touched(shapes, pair = this.current) {
    const row = this.row(pair), solved = this.solved.get(pair);
    return shapes.filter((shape) => this.differs(shape, pair) && solved?.get(shape) !== row[shape]);
  }

  /** Set solved weights, which do not count as set by hand. */
  putSolved(values, pair) {
    this.endGesture();
    this.set(values, null, pair);
    if (!this.solved.has(pair)) this.solved.set(pair, new Map());
    for (const shape of values.keys()) this.solved.get(pair).set(shape, this.row(pair)[shape]);
  }

  go(pair) {
    const count = this.pairs.length;
    this.current = Math.max(0, Math.min(count - 1, pair));
    this.endGesture();
    this.dispatchEvent(new CustomEvent("pair"));
  }

  /** Set one shape within its range, and its partner if sides are linked; a drag is one undo step. */
  slide(shape, value) {
    const partner = this.mirror[shape];
    const both = this.linked && partner !== shape && this.sided[shape] && this.sided[partner];
    const limited = (k) => Math.max(this.low[k], Math.min(this.high[k], value));
    const moved = [shape, ...(both ? [partner] : [])].map((k) => [k, limited(k)]);
    this.set(new Map(moved), `slide ${shape}`);
  }

  /** Set shapes of the current pair. Changes with the same gesture are one step of undo. */
  set(values, gesture = null, pair = this.current) {
    const row = this.row(pair);
    const step = { pair, before: new Map(), after: new Map() };
    for (const [shape, value] of values) {
      const single = Math.fround(value); // as stored in layers
      if (single === row[shape] || !Number.isFinite(single)) continue;
      step.before.set(shape, row[shape]);
      step.after.set(shape, single);
    }
    if (!step.after.size) return;
    const last = this.past.at(-1);
    if (gesture !== null && this.gesture === gesture && last?.pair === pair) {
      for (const [shape, value] of step.before) {
        if (!last.before.has(shape)) last.before.set(shape, value);
      }
      for (const [shape, value] of step.after) last.after.set(shape, value);
    } else {
      this.past.push(step);
    }
    this.gesture = gesture;
    this.future = [];
    this.#put(pair, step.after);
  }

  endGesture() {
    this.gesture = null;
  }

  reset(shapes = this.changed()) {
    this.endGesture();
    this.set(new Map(shapes.map((shape) => [shape, this.proposal()[shape]])));
  }

  /** Reset one shape, and its partner while sides are linked. */
  resetShape(shape) {
    const partner = this.mirror[shape];
    const both = this.linked && this.sided[shape] && this.sided[partner];
    this.reset(both ? [shape, partner] : [shape]);
  }

  mirrorPair() {
    this.endGesture();
    const row = this.row();
    this.set(new Map(this.mirror.map((partner, shape) => [shape, row[partner]])));
  }

  /** Copy the weights of another pair, of all or some shapes. */
  copyFrom(pair, shapes = this.names.keys()) {
    this.endGesture();
    const row = this.row(pair);
    this.set(new Map(Array.from(shapes, (shape) => [shape, row[shape]])));
  }

  setDone(done, pair = this.current) {
    if (this.done[pair] === done) return;
    this.past.push({ pair, done });
    this.future = [];
    this.endGesture();
    this.#putDone(pair, done);
  }

  undo() {
    this.#step(this.past, this.future, "before");
  }

  redo() {
    this.#step(this.future, this.past, "after");
  }

  #step(from, to, side) {
    const step = from.pop();
    if (!step) return;
    to.push(step);
    if (step.pair !== this.current) this.go(step.pair);
    this.endGesture();
    if (step.done !== undefined) this.#putDone(step.pair, side === "after" ? step.done : !step.done);
    else this.#put(step.pair, step[side]);
  }

  #put(pair, values) {
    const row = this.row(pair);
    for (const [shape, value] of values) row[shape] = value;
    const shapes = [...values.keys()];
    this.dispatchEvent(new CustomEvent("weights", { detail: { pair, shapes } }));
  }

  #putDone(pair, done) {
    this.done[pair] = done;
    this.dispatchEvent(new CustomEvent("done", { detail: { pair } }));
  }
}
