// Queue of changes to the server: the newest value of each shape, one request at a time.
// Unacknowledged changes are stored in the browser and sent when the page is opened again.

const RETRY_MS = 1500;
const SLOWEST_MS = 15000;

/** Send JSON with the guard's header; the answer has its `status`, and a `reason` if it was refused. */
export async function post(path, body) {
  try {
    const response = await fetch(path, {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-Usdface-Tune": "1" },
      body: JSON.stringify(body),
    });
    const { ok, status } = response;
    const answer = await response.json().catch(() => ({})); // the guard refuses in plain text
    return ok ? { status, ...answer } : { status, reason: answer.reason ?? `the server answered ${status}` };
  } catch {
    return { status: 0, reason: "the server does not answer" };
  }
}

/** Emits `status` (detail: kind 'saved' | 'busy' | 'bad', text) and `outdated` (read the state). */
export class Outbox extends EventTarget {
  /** @param {string} name of the asset, key of the stored changes */
  constructor(state, name) {
    super();
    this.state = state;
    this.key = `usdface tune ${name}`;
    this.revision = 0;
    this.waiting = new Map(); // pair → {weights: Map shape → value, done?}
    this.flying = null;
    this.failures = 0;
    this.sent = 0;
    state.addEventListener("weights", ({ detail: { pair, shapes } }) => {
      const { weights } = this.#entry(pair);
      for (const shape of shapes) weights.set(shape, state.row(pair)[shape]);
      this.#queue();
    });
    state.addEventListener("done", ({ detail: { pair } }) => {
      this.#entry(pair).done = state.done[pair];
      this.#queue();
    });
  }

  get isEmpty() {
    return !this.waiting.size && !this.flying;
  }

  /** Apply unacknowledged changes to a state that was just read. */
  overlay() {
    for (const batch of [this.flying, this.waiting]) {
      for (const [pair, { weights, done }] of batch ?? []) {
        for (const [shape, value] of weights) this.state.row(pair)[shape] = value;
        if (done !== undefined) this.state.done[pair] = done;
      }
    }
  }

  /** Restore unsent changes of an earlier page; returns the number of values. */
  recover() {
    let found = 0;
    let kept = [];
    try {
      kept = JSON.parse(localStorage.getItem(this.key) ?? "[]");
    } catch {
      kept = [];
    }
    for (const change of kept) {
      const { take, frame } = change; // its index may be another after selecting again
      const pair = this.state.pairs.findIndex((each) => each.take === take && each.frame === frame);
      if (pair < 0) continue;
      const known = Object.entries(change.weights)
        .map(([name, value]) => [this.state.names.indexOf(name), value])
        .filter(([shape, value]) => shape >= 0 && this.state.row(pair)[shape] !== value);
      found += known.length;
      this.state.set(new Map(known), null, pair); // can be undone
      if (typeof change.done === "boolean") this.state.setDone(change.done, pair);
    }
    return found;
  }

  #entry(pair) {
    if (!this.waiting.has(pair)) this.waiting.set(pair, { weights: new Map() });
    return this.waiting.get(pair);
  }

  #changes(batch) {
    return [...batch].map(([pair, { weights, done }]) => ({
      pair,
      take: this.state.pairs[pair].take,
      frame: this.state.pairs[pair].frame,
      weights: Object.fromEntries([...weights].map(([k, value]) => [this.state.names[k], value])),
      ...(done === undefined ? {} : { done }),
    }));
  }

  #queue() {
    this.#keep();
    this.#say("busy", "saving");
    if (!this.flying && !this.timer) this.#send();
  }

  /** Store unacknowledged changes in the browser. */
  #keep() {
    try {
      if (this.isEmpty) localStorage.removeItem(this.key);
      else {
        const all = [...this.#changes(this.flying ?? []), ...this.#changes(this.waiting)];
        localStorage.setItem(this.key, JSON.stringify(all));
      }
    } catch {
      // No storage: changes are kept in the page only.
    }
  }

  async #send() {
    clearTimeout(this.timer);
    this.timer = 0;
    if (this.flying || !this.waiting.size) return;
    this.flying = this.waiting;
    this.waiting = new Map();
    const fault = await this.#post(this.#changes(this.flying));
    if (fault) {
      for (const [pair, entry] of this.flying) this.#putBack(pair, entry);
      this.flying = null;
      this.failures++;
      if (fault.again) {
        await fault.again();
        this.#send();
        return;
      }
      this.#say("bad", fault.text);
      this.timer = setTimeout(() => this.#send(), Math.min(RETRY_MS * this.failures, SLOWEST_MS));
      return;
    }
    this.failures = 0;
    this.sent++;
    this.flying = null;
    this.#keep();
    if (this.waiting.size) this.#send();
    else this.#say("saved", "saved");
  }

  /** Returns the fault, or null if the changes are on disk. */
  async #post(changes) {
    const { status, reason, revision } = await post("/changes", { revision: this.revision, changes });
    if (status === 403) {
      return { text: "not saved: the server was started anew; open the link in its terminal" };
    }
    if (status === 409) return { again: () => this.#catchUp() };
    if (reason) return { text: `not saved: ${reason}${status ? "" : "; trying again"}` };
    this.revision = revision;
    return null;
  }

  /** After a change by someone else: read the weights and apply ours to them. */
  async #catchUp() {
    await new Promise((resolve) => {
      this.dispatchEvent(new CustomEvent("outdated", { detail: { resolve } }));
    });
  }

  /** Queue unsent values again, unless they have changed since. */
  #putBack(pair, { weights, done }) {
    const entry = this.#entry(pair);
    for (const [shape, value] of weights) {
      if (!entry.weights.has(shape)) entry.weights.set(shape, value);
    }
    entry.done ??= done;
  }

  #say(kind, text) {
    this.dispatchEvent(new CustomEvent("status", { detail: { kind, text } }));
  }
}
