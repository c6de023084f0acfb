// The report's player: one clock for video, face, curves, strips and notes.

import { node } from "./elements.js";
import { NOTHING, announce, byId, count, data, inflate, pictureOf, tell } from "./report_page.js";
import { oneTabStop } from "./tab_stops.js";
import { Curves, stripValue } from "./report_curves.js";
import { Stage } from "./report_face.js";
import { Notes } from "./report_notes.js";

const FASTEST = 4;
const QUIET_MS = 350; // until a frame is announced to screen readers

class Report {
  constructor(face, curves) {
    this.curves = curves;
    this.picture = -1;
    this.playing = false;
    this.speed = 1;
    this.way = 1;
    this.range = null;
    this.looping = false;
    this.naming = 0;
    this.scriptMillis = 0;
    this.viewer = new FaceViewer(byId("face"), face);
    const column = new Map(data.shapes.map((name, index) => [name, index]));
    this.columns = face.names.map((name) => column.get(name) ?? -1);
    this.video = data.movie ? byId("video") : null;
    this.seeking = false;
    this.wanted = null;
    this.stage = new Stage(this.viewer, (curve, picture) => this.weightsAt(picture, curve));
    this.plots = new Curves(curves);
    this.notes = new Notes(new Map([["face", byId("facePane")], ["video", byId("videoPane")]]), this.#player());
  }

  /** Show a picture; the video seeks to it unless it is the source. */
  show(picture, { fromVideo = false } = {}) {
    const at = Math.min(Math.max(Math.round(picture), 0), count - 1);
    if (at === this.picture) return;
    const start = performance.now();
    this.picture = at;
    this.stage.show(at);
    const frame = data.frames[at], code = data.timecodes[at] ?? "";
    byId("clock").textContent = `${code}  ${frame}`.trim();
    byId("spoken").textContent = data.labels[data.spoken[at]] ?? "";
    clearTimeout(this.naming); // browsers limit changes of the address
    this.naming = setTimeout(() => this.#settled(), QUIET_MS);
    const scrub = byId("scrub");
    scrub.value = at;
    scrub.setAttribute("aria-valuetext", `frame ${frame}${code ? `, ${code}` : ""}`);
    this.plots.show(at, this.stage.curve);
    this.notes.show(at);
    for (const link of byId("worst").querySelectorAll("a")) {
      link.setAttribute("aria-current", String(link.hash === `#${frame}`));
    }
    this.#command(frame);
    if (this.video && !fromVideo) this.seek(at);
    this.scriptMillis = performance.now() - start;
  }

  weightsAt(at, curve = this.stage.curve) {
    const { values } = this.curves[curve];
    const weights = Float32Array.from(this.columns, (column) => {
      const step = column < 0 ? 0 : values[column * count + at];
      return step === NOTHING ? 0 : step / data.steps;
    });
    const change = curve === 0 ? this.notes?.correction(at) : null;
    const place = change ? this.viewer.face.names.indexOf(change.shape) : -1;
    if (place >= 0) weights[place] = change.override ?? weights[place] + change.add;
    return weights;
  }

  /** Go to the next or the previous moment to review, in order of time. */
  review(way) {
    const moments = data.worst.map(({ picture }) => picture).sort((a, b) => a - b);
    const next = way > 0 ? moments.find((at) => at > this.picture) : moments.findLast((at) => at < this.picture);
    this.play(false);
    this.show(next ?? moments.at(way > 0 ? 0 : -1) ?? this.picture);
  }

  step(by) {
    this.play(false);
    this.show(this.picture + by);
  }

  /** Seek the video; during a seek, only the newest request is queued. */
  seek(picture) {
    if (this.seeking) { this.wanted = picture; return; }
    const to = (picture + 0.5) / data.rate;
    if (Math.abs(this.video.currentTime - to) < 1e-4) return;
    this.seeking = true;
    this.video.currentTime = to;
  }

  seeked() {
    this.seeking = false;
    this.#restart(); // a playing video is the clock from here
    if (this.wanted !== null) {
      const picture = this.wanted;
      this.wanted = null;
      this.seek(picture);
    }
  }

  /** Play forward or in reverse; the video is the clock when it plays forward. */
  play(on = !this.playing, { way = 1, speed = Number(byId("speed").value) } = {}) {
    this.playing = on;
    this.way = way;
    this.speed = speed;
    byId("play").textContent = on ? "❚❚" : "▶";
    byId("play").setAttribute("aria-label", on ? "Pause" : "Play");
    const [first, last] = this.#limits();
    if (on && (way > 0 ? this.picture >= last : this.picture <= first)) this.show(way > 0 ? first : last);
    if (this.video) {
      this.video.playbackRate = speed;
      if (on && way > 0) this.video.play().catch(() => this.play(false)); else this.video.pause();
    }
    this.#restart();
    cancelAnimationFrame(this.ticking);
    if (on) this.ticking = requestAnimationFrame((now) => this.#tick(now));
  }

  /** J and L: play in reverse or forward; pressed again, twice as fast. */
  shuttle(way) {
    const faster = this.playing && this.way === way;
    this.play(true, { way, speed: faster ? Math.min(2 * this.speed, FASTEST) : Number(byId("speed").value) });
  }

  /** Set one end of the range to the current picture. */
  mark(end) {
    const [first, last] = this.range ?? [0, count - 1];
    const at = this.picture;
    this.setRange(end === "first" ? [at, last > at ? last : count - 1] : [first < at ? first : 0, at]);
  }

  setRange(range, looping = true) {
    this.range = range && range[1] > range[0] ? range : null;
    this.looping = looping && this.range !== null;
    byId("loop").setAttribute("aria-pressed", String(this.looping));
    byId("range").textContent = this.range ? `${data.frames[this.range[0]]}–${data.frames[this.range[1]]}` : "";
    byId("clear").hidden = byId("toRange").hidden = !this.range;
    this.plots.mark(this.range);
    this.notes.rangeChanged();
  }

  openVideo() {
    if (!this.video) {
      byId("screens").classList.add("alone");
      return;
    }
    byId("videoPane").hidden = false;
    const { video } = this;
    video.src = URL.createObjectURL(
      new Blob([bytesFromBase64(byId("movie").textContent)], { type: data.movie }),
    );
    video.addEventListener("seeked", () => this.seeked());
    video.addEventListener("ended", () => { if (this.playing) this.#arrive(); });
    video.addEventListener("error", () => {
      tell("the video cannot be played by this browser; the face and the curves still can");
      this.video = null;
    });
    this.mediaTime = null; // of the displayed picture, if the browser reports it
    const follow = (_now, { mediaTime }) => {
      this.mediaTime = mediaTime;
      video.requestVideoFrameCallback(follow);
    };
    video.requestVideoFrameCallback?.(follow);
  }

  fillWorst() {
    for (const { picture, region, reason } of data.worst) {
      const frame = data.frames[picture];
      const still = node("canvas", { width: 128, height: 128, "aria-hidden": "true" });
      still.getContext("2d").putImageData(this.viewer.thumbnail(this.weightsAt(picture), 128, 128), 0, 0);
      const link = node("a", { href: `#${frame}` }, still, node("span", {}, `${frame} ${region}`.trim()), node("span", {}, data.timecodes[picture] ?? ""), node("small", {}, reason));
      byId("worst").append(node("li", {}, link));
    }
    if (!data.worst.length) byId("worst").append(node("li", {}, "no outstanding moments"));
  }

  fromAddress(hash = location.hash) {
    const frame = Number.parseInt(hash.slice(1), 10);
    if (!Number.isFinite(frame)) return;
    this.play(false);
    const at = pictureOf(frame);
    this.show(at);
    if (data.frames[at] !== frame) announce(`frame ${frame} is not in this report; this is ${data.frames[at]}`);
  }

  wire() {
    const scrub = byId("scrub");
    scrub.max = count - 1;
    const on = (id, event, action) => byId(id).addEventListener(event, action);
    on("scrub", "input", () => { this.play(false); this.show(Number(scrub.value)); });
    on("play", "click", () => this.play());
    on("back", "click", () => this.step(-1));
    on("on", "click", () => this.step(1));
    on("speed", "change", () => { if (this.playing) this.play(true, { way: this.way }); });
    on("loop", "click", () => this.#loop());
    on("clear", "click", () => this.setRange(null));
    on("toRange", "click", () => this.#zoomToRange());
    on("which", "posed", () => this.plots.show(this.picture, this.stage.curve));
    on("copy", "click", () => this.#copy());
    on("help", "click", () => byId("help").setAttribute("aria-expanded", String(!byId("keys").toggleAttribute("hidden"))));
    this.plots.addEventListener("seek", ({ detail }) => { this.play(false); this.show(detail); });
    this.plots.addEventListener("range", ({ detail }) => this.setRange(detail.map((at) => Math.min(Math.max(at, 0), count - 1))));
    this.notes.addEventListener("seek", ({ detail }) => { this.play(false); this.show(detail); });
    this.notes.addEventListener("preview", () => this.stage.again());
    for (const image of document.querySelectorAll(".picture img")) {
      const zoom = image.parentElement;
      zoom.addEventListener("click", () => zoom.setAttribute("aria-expanded", String(zoom.parentElement.classList.toggle("full"))));
    }
    // Not the current address, which a settled frame may have changed in between.
    addEventListener("hashchange", ({ newURL }) => this.fromAddress(new URL(newURL).hash));
    // A link to the frame that is in the address causes no hashchange.
    addEventListener("click", ({ target, ctrlKey, metaKey, shiftKey }) => {
      const link = target.closest?.("a[href^='#']");
      if (link && !(ctrlKey || metaKey || shiftKey)) this.fromAddress(link.hash);
    });
    addEventListener("keydown", (event) => this.#key(event));
    document.querySelectorAll("#worst, #transport, #tools, #noteBook .bar, #notes, #time, #legend, #tables").forEach((part) => oneTabStop(part));
    addEventListener("beforeprint", () => this.keepStill());
  }

  /** Replace the WebGL canvas, which prints empty, by a picture. */
  keepStill() {
    this.plots.drawAll();
    const still = byId("still");
    const image = this.viewer.thumbnail(this.weightsAt(this.picture), 640, 640);
    still.width = image.width;
    still.height = image.height;
    still.getContext("2d").putImageData(image, 0, 0);
  }

  /** Interface of the player for the notes. */
  #player() {
    const report = this;
    return {
      get picture() { return Math.max(report.picture, 0); },
      get range() { return report.range; },
      pause: () => report.play(false),
      view() {
        const { yaw, pitch, distance, target } = report.viewer.camera;
        return { yaw, pitch, distance, target: [...target] };
      },
      look({ yaw, pitch, distance, target }) {
        if (![yaw, pitch, distance, ...(target ?? [NaN])].every(Number.isFinite) || target.length !== 3) return;
        Object.assign(report.viewer.camera, { yaw, pitch, distance, target: [...target] });
        report.viewer.invalidate();
      },
    };
  }

  #limits() {
    return this.looping && this.range ? this.range : [0, count - 1];
  }

  /** Start the clock at the current picture. */
  #restart() {
    this.from = this.picture;
    this.begun = performance.now();
    this.mediaTime = null;
  }

  #tick(now) {
    if (!this.playing) return;
    const led = this.video && this.way > 0;
    const seconds = Math.max(now - this.begun, 0) / 1000; // the frame's time stamp may be earlier
    let at = this.from + this.way * Math.floor(seconds * data.rate * this.speed);
    if (led) at = this.seeking ? this.picture : Math.floor((this.mediaTime ?? this.video.currentTime) * data.rate + 1e-3);
    const [first, last] = this.#limits();
    if (this.looping && !led) { // a loop may be shorter than a refresh of the screen
      const span = last - first + 1;
      at = first + ((((at - first) % span) + span) % span);
      this.show(at);
      this.ticking = requestAnimationFrame((next) => this.#tick(next));
      return;
    }
    if (this.way > 0 ? at >= last && (this.looping || !led) : at <= first) { this.#arrive(); return; }
    this.show(at, { fromVideo: led });
    this.ticking = requestAnimationFrame((next) => this.#tick(next));
  }

  /** At the end: restart the loop, or pause on the last picture. */
  #arrive() {
    const [first, last] = this.#limits();
    this.show(this.way > 0 ? last : first, { fromVideo: true });
    if (!this.looping) { this.play(false); return; }
    this.show(this.way > 0 ? first : last);
    this.play(true, { way: this.way, speed: this.speed });
  }

  /** After a pause: put the frame into the address, and announce it to screen readers. */
  #settled() {
    const frame = data.frames[this.picture];
    history.replaceState(null, "", `#${frame}`);
    if (this.playing) return;
    const moment = data.worst.find(({ picture }) => picture === this.picture);
    const figures = data.strips.map((strip) => {
      const value = stripValue(strip, this.picture, "unknown");
      return `${strip.name} ${value}${strip.unit === "%" || value === "unknown" ? "" : ` ${strip.unit}`}`;
    });
    announce([`frame ${frame}`, moment && `${moment.region} ${moment.reason}`, ...figures].filter(Boolean).join(", "));
  }

  #loop() {
    if (this.range) this.setRange(this.range, !this.looping);
    else this.setRange([0, count - 1]);
  }

  #zoomToRange() {
    if (this.range) this.plots.zoomTo(...this.range);
  }

  /** Show the command that opens the frame in the tuning page. */
  #command(frame) {
    const { add, tune, pairs } = data.commands;
    byId("copy").parentElement.hidden = !tune;
    if (!tune) return;
    const text = pairs.includes(frame) ? `${tune} --frame ${frame}` : `${add} --frames ${frame} && ${tune} --frame ${frame}`;
    byId("command").value = text;
  }

  async #copy() {
    const text = byId("command").value;
    try {
      await navigator.clipboard.writeText(text);
    } catch { // no permission: select the text, to be copied by hand
      byId("command").select();
      document.execCommand?.("copy");
    }
    clearTimeout(this.naming);
    this.#settled();
    announce(`copied: ${text}`);
  }

  #key(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const { target } = event;
    if (event.key === "Escape") {
      if (this.notes.drawing) this.notes.draw(false);
      else if (!byId("noteForm").hidden) this.notes.close();
      else this.setRange(null);
      return;
    }
    if (target.matches?.("input:not([type=range], [type=checkbox]), textarea")) return;
    // Keys of the focused element: space of a button, letters of a list, arrows of the face.
    if (event.key === " " && target.matches?.("button, input, select") && target !== byId("scrub")) return;
    if (target.matches?.("select")) return;
    if (target === byId("face") && /^(Arrow|[+=\-0f]$)/i.test(event.key)) return;
    if (target.matches?.("input[type=range]") && /^(Arrow|Home|End|Page)/.test(event.key)) return;
    const press = (id) => () => byId(id).click();
    const actions = {
      " ": () => this.play(), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
      Home: () => this.step(-Infinity), End: () => this.step(Infinity),
      n: () => this.review(1), p: () => this.review(-1),
      j: () => this.shuttle(-1), k: () => this.play(false), l: () => this.shuttle(1),
      "[": () => this.mark("first"), "]": () => this.mark("last"), o: () => this.#loop(),
      s: () => this.#nextSpeed(), z: () => this.#zoomToRange(), "+": () => this.plots.zoom(0.5),
      "=": () => this.plots.zoom(0.5), "-": () => this.plots.zoom(2), 0: () => this.plots.zoomAll(),
      t: () => this.notes.open(), d: () => this.notes.draw(), m: press("markers"), h: press("heat"), e: press("head"),
      "?": press("help"),
    };
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  #nextSpeed() {
    const speed = byId("speed");
    speed.selectedIndex = (speed.selectedIndex + 1) % speed.options.length;
    speed.dispatchEvent(new Event("change"));
    announce(`speed ${speed.selectedOptions[0].text}`);
  }
}

try {
  const header = JSON.parse(byId("faceHeader").textContent);
  const face = await unpackFace(header, bytesFromBase64(byId("faceData").textContent));
  const curves = [];
  for (const [index, each] of data.curves.entries()) curves.push({ ...each, values: new Int16Array(await inflate(`curve-${index}`)) });
  const report = new Report(face, curves);
  await report.stage.load();
  report.openVideo();
  report.fillWorst();
  report.wire();
  report.show(0);
  report.fromAddress();
  globalThis.report = report; // for tests
  document.body.dataset.ready = "true";
} catch (error) {
  tell(`this page cannot be shown: ${error.message}`);
  throw error;
}
