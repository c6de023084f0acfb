// Notes on frames: text, drawings, or corrections with a preview on the face; saved as JSON.

import { button, node } from "./elements.js";
import { announce, byId, data, pictureOf, tell } from "./report_page.js";

const FORMAT_OF_NOTES = 1;
const LONGEST_NOTE = 4000;
const LARGEST_NOTES = 16 << 20;
const INK = "#ffdb4d";
const TEXTS = ["id", "text", "author", "made", "version"];

const stamp = () => new Date().toISOString();
const newId = () => `${Date.now().toString(36)}-${Math.random().toString(36).slice(2, 8)}`;

/** Merge two lists of notes; of a note in both, the version changed last is kept. */
function merged(one, other) {
  const byName = new Map(one.map((note) => [note.id, note]));
  for (const note of other) {
    const known = byName.get(note.id);
    if (!known || (note.made ?? "") >= (known.made ?? "")) byName.set(note.id, note);
  }
  return [...byName.values()].sort((a, b) => a.frame - b.frame);
}

/** Parse a file of notes; throws if it is not one. */
function readNotes(text) {
  const file = JSON.parse(text);
  const format = file?.usdface_notes;
  if (format > FORMAT_OF_NOTES) throw new Error(`has format ${format}, of a newer version of usdface`);
  if (format !== FORMAT_OF_NOTES || !Array.isArray(file.notes)) {
    throw new Error("not a file of notes of a usdface report");
  }
  const fits = (note) => typeof note.id === "string" && Number.isInteger(note.frame)
    && TEXTS.every((key) => typeof (note[key] ?? "") === "string")
    && (note.strokes ?? []).every(({ points }) => points.every(Array.isArray));
  if (!file.notes.every(fits)) throw new Error("a note lacks its id, frame or text");
  return file.notes;
}

/** Emits `seek` (detail: picture), and `preview` when the correction in the form changes. */
export class Notes extends EventTarget {
  /** @param panes {Map<string, HTMLElement>} elements to draw on, by name: face, video */
  constructor(panes, player) {
    super();
    this.player = player; // {picture, range, view(): camera, look(camera)}
    this.key = `usdface-notes ${location.pathname} ${data.performance}`;
    this.removed = new Map(); // id → time
    this.notes = merged(data.notes, []);
    this.saved = JSON.stringify(this.notes);
    this.#join();
    this.strokes = [];
    this.drawing = false;
    this.inks = new Map();
    for (const [name, pane] of panes) this.#overlay(name, pane);
    this.#wire();
    this.fill();
  }

  /** The correction in the form if it applies to a picture, else null. */
  correction(picture) {
    const { change } = this;
    const frame = data.frames[picture];
    if (!change || frame < change.frame || frame > (change.last ?? change.frame)) return null;
    return change;
  }

  /** Show the drawings of the frame's notes, and mark these notes. */
  show(picture) {
    this.picture = picture;
    const frame = data.frames[picture];
    const here = this.notes.filter((note) => frame >= note.frame && frame <= (note.last ?? note.frame));
    for (const [id, item] of this.items) item.setAttribute("aria-current", String(here.some((note) => note.id === id)));
    // Drawings are of one frame; on others they would point elsewhere.
    this.#ink([...this.strokes, ...here.filter((note) => note.frame === frame && !note.done).flatMap((note) => note.strokes ?? [])]);
  }

  /** Open the form. */
  open() {
    byId("noteForm").hidden = false;
    this.#where();
    byId("noteText").focus();
  }

  close() {
    this.draw(false);
    this.strokes = [];
    this.editing = null;
    byId("noteForm").reset();
    byId("noteAuthor").value = this.author;
    byId("noteForm").hidden = true;
    this.#correct();
    this.show(this.player.picture);
  }

  /** Switch the pointer between drawing on face and video and turning the face. */
  draw(on = !this.drawing) {
    this.drawing = on;
    byId("draw").setAttribute("aria-pressed", String(on));
    for (const { svg } of this.inks.values()) svg.classList.toggle("drawing", on);
    if (on) {
      this.player.pause();
      this.open();
      announce("draw on the face or the video; Escape ends it");
    }
  }

  fill() {
    this.items = new Map();
    byId("notes").replaceChildren(...this.notes.map((note) => this.#item(note)));
    const open = this.notes.filter((note) => !note.done).length;
    byId("noteCount").textContent = this.notes.length ? `${open} open of ${this.notes.length}` : "none yet";
    const unsaved = JSON.stringify(this.notes) !== this.saved;
    byId("save").disabled = !this.notes.length;
    byId("unsaved").hidden = !unsaved;
    this.show(this.player.picture ?? 0);
  }

  /** Save a file: to a chosen place if the browser can, else as a download. */
  async save() {
    const text = this.text();
    const blob = new Blob([text], { type: "application/json" });
    try {
      if (globalThis.showSaveFilePicker) {
        this.handle ??= await showSaveFilePicker({ suggestedName: data.notesFile, types: [{ description: "Notes", accept: { "application/json": [".json"] } }] });
        const stream = await this.handle.createWritable();
        await stream.write(blob);
        await stream.close();
      } else {
        const link = node("a", { href: URL.createObjectURL(blob), download: data.notesFile });
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
      }
    } catch (error) {
      if (error.name !== "AbortError") tell(`the notes are not saved: ${error.message}; they stay in this page`);
      this.handle = null;
      return;
    }
    this.saved = JSON.stringify(this.notes);
    announce(`notes saved as ${this.handle?.name ?? data.notesFile}`);
    this.fill();
  }

  text(more = {}) {
    const { performance, take } = data;
    return `${JSON.stringify({ usdface_notes: FORMAT_OF_NOTES, performance, take, notes: this.notes, ...more }, null, 1)}\n`;
  }

  /** Add the notes of a file. */
  async load(file) {
    try {
      if (file.size > LARGEST_NOTES) throw new Error("it is larger than 16 MB");
      const found = readNotes(await file.text());
      this.notes = merged(this.notes, found);
      announce(`${found.length} notes from ${file.name}`);
      tell("");
      this.#changed(found.map(({ id }) => [id, ""])); // restored if they were deleted
    } catch (error) {
      tell(`${file.name}: cannot be read as notes: ${error.message}`);
    }
  }

  /** Merge with what this page stored in the browser, perhaps in another tab. */
  #join(removed = []) {
    let known = [];
    try {
      const kept = localStorage.getItem(this.key);
      if (kept) {
        this.notes = merged(readNotes(kept), this.notes);
        known = JSON.parse(kept).removed ?? [];
      }
    } catch { /* no storage */ }
    this.removed = new Map([...this.removed, ...known, ...removed]);
    this.notes = this.notes.filter(({ id, made }) => !((made ?? "") < this.removed.get(id)));
  }

  #changed(removed = []) {
    this.#join(removed);
    try {
      localStorage.setItem(this.key, this.text({ removed: [...this.removed] }));
    } catch { /* no storage: the page shows that notes are not saved */ }
    this.fill();
  }

  get author() {
    try { return localStorage.getItem("usdface-author") ?? ""; } catch { return ""; }
  }

  #wire() {
    const on = (id, event, action) => byId(id).addEventListener(event, action);
    byId("noteAuthor").value = this.author;
    byId("noteText").maxLength = LONGEST_NOTE;
    for (const shape of data.shapes) byId("shapeNames").append(node("option", { value: shape }));
    on("note", "click", () => this.open());
    on("draw", "click", () => this.draw());
    on("save", "click", () => this.save());
    on("load", "click", () => byId("file").click());
    on("file", "change", (event) => {
      for (const file of event.target.files) this.load(file);
      event.target.value = "";
    });
    on("cancel", "click", () => this.close());
    on("noteForm", "submit", (event) => { event.preventDefault(); this.#add(); });
    for (const id of ["noteShape", "noteChange", "noteFade"]) on(id, "input", () => this.#correct());
    on("noteKind", "change", () => this.#correct());
    on("noteRange", "change", () => this.#where());
    addEventListener("storage", ({ key }) => { if (key === this.key) { this.#join(); this.fill(); } });
    addEventListener("dragover", (event) => event.preventDefault());
    addEventListener("drop", (event) => {
      event.preventDefault();
      for (const file of event.dataTransfer.files) this.load(file);
    });
  }

  /** First and last frame of the note in the form. */
  #frames() {
    const { range, picture } = this.player;
    if (range && byId("noteRange").checked) return range.map((at) => data.frames[at]);
    const frame = this.editing?.frame ?? data.frames[picture];
    return [frame, this.editing?.last ?? frame];
  }

  /** Show the frames of the note in the form. */
  #where() {
    const { range } = this.player;
    byId("noteRangeLabel").hidden = !range;
    const [first, last] = this.#frames();
    byId("noteWhere").textContent = first === last ? `frame ${first}` : `frames ${first}–${last}`;
    this.#correct();
  }

  rangeChanged() {
    if (!byId("noteForm").hidden) this.#where();
  }

  #correct() {
    const shape = byId("noteShape").value.trim(), value = byId("noteChange").valueAsNumber;
    const known = data.shapes.includes(shape);
    byId("noteShape").setCustomValidity(shape && !known ? "the rig has no such shape" : "");
    byId("noteChange").required = Boolean(shape);
    const [frame, last] = this.#frames();
    this.change = !byId("noteForm").hidden && known && Number.isFinite(value)
      ? { shape, [byId("noteKind").value]: value, frame, last } : null;
    this.dispatchEvent(new Event("preview"));
  }

  #add() {
    const text = byId("noteText").value.trim();
    const { change } = this;
    if (!text && !change && !this.strokes.length) { byId("noteText").focus(); return; }
    const [frame, last] = this.#frames();
    const author = byId("noteAuthor").value.trim();
    const note = { id: newId(), ...this.editing, frame, text, author, made: stamp(), version: data.version };
    if (last > frame) note.last = last; else delete note.last;
    for (const key of ["shape", "add", "override", "fade"]) delete note[key];
    if (change) {
      Object.assign(note, { shape: change.shape, [byId("noteKind").value]: byId("noteChange").valueAsNumber });
      note.fade = byId("noteFade").valueAsNumber || 0;
    }
    if (this.strokes.length) {
      note.strokes = this.strokes;
      note.view = this.player.view();
    }
    try { localStorage.setItem("usdface-author", author); } catch { /* no storage */ }
    this.notes = merged(this.notes.filter(({ id }) => id !== note.id), [note]);
    this.close();
    this.#changed();
    announce(`note on frame ${frame} added`);
  }

  #item(note) {
    const inside = note.frame >= data.frames[0] && note.frame <= data.frames.at(-1);
    const span = note.last > note.frame ? `${note.frame}–${note.last}` : `${note.frame}`;
    const link = node(inside ? "a" : "span", inside ? { href: `#${note.frame}` } : {}, span);
    link.addEventListener("click", () => { if (note.view) this.player.look(note.view); });
    const words = node("p", {}, node("strong", {}, link), ` ${note.text ?? ""}`);
    if (note.shape) {
      const [sign, value] = note.add === undefined ? ["=", note.override] : [note.add < 0 ? "−" : "+", Math.abs(note.add)];
      words.append(" ", node("code", {}, `${note.shape} ${sign} ${value}`));
    }
    if (note.strokes?.length) words.append(" ✎");
    const from = [note.author, (note.made ?? "").slice(0, 16).replace("T", " ")].filter(Boolean).join(", ");
    const facts = node("small", {}, from);
    const old = note.version !== data.version;
    if (old) facts.append(" ", node("em", {}, "on another version"));
    if (!inside) facts.append(" ", node("em", {}, "outside this report"));
    const done = node("input", { type: "checkbox", "aria-label": `Done: ${note.text ?? ""}` });
    done.checked = Boolean(note.done);
    done.addEventListener("change", () => this.#change(note, { done: done.checked }));
    const actions = [node("label", {}, done, " done"), button("Edit", "Edit this note", () => this.#edit(note))];
    if (old) actions.push(button("Still valid", "Make it a note on this version", () => this.#change(note, { version: data.version })));
    actions.push(button("Delete", "Delete this note", () => {
      this.#changed([[note.id, stamp()]]);
    }));
    const item = node("li", { class: note.done ? "done" : "" }, words, facts, node("div", { class: "acts" }, ...actions));
    this.items.set(note.id, item);
    return item;
  }

  #change(note, what) {
    Object.assign(note, what, { made: stamp() });
    this.#changed();
  }

  #edit(note) {
    this.close();
    if (note.frame >= data.frames[0]) this.dispatchEvent(new CustomEvent("seek", { detail: pictureOf(note.frame) }));
    this.editing = note;
    this.strokes = [...(note.strokes ?? [])];
    byId("noteText").value = note.text ?? "";
    byId("noteShape").value = note.shape ?? "";
    byId("noteKind").value = note.override === undefined ? "add" : "override";
    byId("noteChange").value = note.add ?? note.override ?? "";
    byId("noteFade").value = note.fade ?? 0;
    byId("noteRange").checked = false;
    this.open();
  }

  /** Add a drawing layer to a pane; coordinates are relative to the picture. */
  #overlay(name, pane) {
    const svg = node("svg", { class: "ink", "aria-hidden": "true" });
    pane.append(svg);
    this.inks.set(name, { svg, pane });
    let line = null;
    const at = (event) => {
      const { left, top } = pane.getBoundingClientRect();
      const { x, y, unit } = this.#frame(name);
      return [(event.clientX - left - x) / unit, (event.clientY - top - y) / unit].map((v) => Number(v.toFixed(4)));
    };
    svg.addEventListener("pointerdown", (event) => {
      if (!this.drawing || event.button) return;
      svg.setPointerCapture(event.pointerId);
      line = { on: name, points: [at(event)] };
      this.strokes.push(line);
    });
    svg.addEventListener("pointermove", (event) => {
      if (!line) return;
      line.points.push(at(event));
      this.show(this.player.picture);
    });
    for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { line = null; });
    new ResizeObserver(() => this.show(this.player.picture ?? 0)).observe(pane);
  }

  /** Coordinate frame of drawings [CSS pixels]: origin at the pane's centre, unit the picture's shorter side. */
  #frame(name) {
    const { pane } = this.inks.get(name);
    const [width, height] = [pane.clientWidth, pane.clientHeight];
    const video = pane.querySelector("video");
    const aspect = video?.videoWidth ? video.videoWidth / video.videoHeight : width / Math.max(height, 1);
    const high = Math.min(height, width / aspect); // of what is fitted into the pane
    return { x: width / 2, y: height / 2, unit: Math.min(high, high * aspect) || 1 };
  }

  #ink(strokes) {
    for (const [name, { svg, pane }] of this.inks) {
      svg.setAttribute("viewBox", `0 0 ${pane.clientWidth || 1} ${pane.clientHeight || 1}`);
      const { x, y, unit } = this.#frame(name);
      const lines = strokes.filter(({ on, points }) => on === name && Array.isArray(points)).map(({ points }) =>
        node("polyline", { stroke: INK, points: points.map(([a, b]) => `${x + unit * a},${y + unit * b}`).join(" ") }));
      svg.replaceChildren(...lines);
    }
  }
}
