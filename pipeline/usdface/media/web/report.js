// The report's player: one clock for video, face, curves and strips.

const data = JSON.parse(document.getElementById("data").textContent);
const count = data.frames.length;
const byId = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const NOTHING = -32768;
const COLUMNS = 1200; // as many as a wide screen shows

function node(name, attributes = {}, ...children) {
  const made = name === "svg" || name === "path" ? document.createElementNS(SVG, name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

async function curve(name) {
  const packed = bytesFromBase64(byId(`curve-${name}`).textContent);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Int16Array(await new Response(stream).arrayBuffer());
}

/** A line through values, its ups and downs kept where there are more values than columns. */
function line(value, low, high, fill = false) {
  const step = Math.max(1, Math.ceil(count / COLUMNS));
  const y = (v) => (1 - (Math.min(Math.max(v, low), high) - low) / (high - low)).toFixed(4);
  let path = "", open = false, first = 0, last = 0;
  for (let start = 0; start < count; start += step) {
    let least = Infinity, most = -Infinity;
    for (let i = start; i < Math.min(start + step, count); i++) {
      const v = value(i);
      if (v === null) continue;
      if (v < least) least = v;
      if (v > most) most = v;
    }
    if (most === -Infinity) { open = false; continue; }
    if (!open) { path += `M${start} ${y(least)}`; open = true; if (path.length < 20) first = start; }
    path += least === most ? `L${start} ${y(most)}` : `L${start} ${y(least)}L${start} ${y(most)}`;
    last = start;
  }
  return fill && path ? `${path}L${last} 1L${first} 1Z` : path;
}

class Report {
  constructor(face, curves) {
    this.curves = curves;
    this.picture = -1;
    this.shown = [];
    this.playing = false;
    this.naming = 0;
    this.scriptMillis = 0;
    this.viewer = new FaceViewer(byId("face"), face);
    const column = new Map(data.shapes.map((name, index) => [name, index]));
    this.columns = Float32Array.from(face.names, (name) => column.get(name) ?? -1);
    this.pose = curves[0];
    this.video = data.movie ? byId("video") : null;
    this.seeking = false;
    this.wanted = null;
  }

  /** Show a picture: the video follows, or led where it plays. */
  show(picture, { fromVideo = false } = {}) {
    const at = Math.min(Math.max(Math.round(picture), 0), count - 1);
    if (at === this.picture) return;
    const start = performance.now();
    this.picture = at;
    this.viewer.setWeights(this.weightsAt(at));
    document.documentElement.style.setProperty("--at", count > 1 ? at / (count - 1) : 0);
    const frame = data.frames[at], code = data.timecodes[at] ?? "";
    byId("clock").textContent = `${code}  ${frame}`.trim();
    byId("said").textContent = data.labels[data.said[at]] ?? "";
    clearTimeout(this.naming); // browsers refuse an address that changes with every frame
    this.naming = setTimeout(() => history.replaceState(null, "", `#${data.frames[this.picture]}`), 200);
    const scrub = byId("scrub");
    scrub.value = at;
    scrub.setAttribute("aria-valuetext", `frame ${frame}${code ? `, ${code}` : ""}`);
    for (const { values, into } of this.shown) into.textContent = values(at);
    for (const link of byId("worst").querySelectorAll("a")) {
      link.setAttribute("aria-current", String(link.hash === `#${frame}`));
    }
    if (this.video && !fromVideo) this.seek(at);
    this.scriptMillis = performance.now() - start;
  }

  weightsAt(at) {
    return this.columns.map((column) => {
      const step = column < 0 ? 0 : this.pose.values[column * count + at];
      return step === NOTHING ? 0 : step / data.steps;
    });
  }

  /** Go to the next or the previous moment to review, in order of time. */
  review(way) {
    const moments = data.worst.map(({ picture }) => picture).sort((a, b) => a - b);
    const next = way > 0 ? moments.find((at) => at > this.picture) : moments.findLast((at) => at < this.picture);
    this.play(false);
    this.show(next ?? moments.at(way > 0 ? 0 : -1) ?? this.picture);
  }

  /** One seek at a time; while one is on its way only the newest is remembered. */
  seek(picture) {
    if (this.seeking) { this.wanted = picture; return; }
    const to = (picture + 0.5) / data.rate;
    if (Math.abs(this.video.currentTime - to) < 1e-4) return;
    this.seeking = true;
    this.video.currentTime = to;
  }

  seeked() {
    this.seeking = false;
    if (this.wanted !== null) {
      const picture = this.wanted;
      this.wanted = null;
      this.seek(picture);
    }
  }

  play(on = !this.playing) {
    this.playing = on;
    byId("play").textContent = on ? "❚❚" : "▶";
    byId("play").setAttribute("aria-label", on ? "Pause" : "Play");
    if (on && this.picture >= count - 1) this.show(0);
    if (this.video) {
      if (on) this.video.play().catch(() => this.play(false)); else this.video.pause();
    } else if (on) {
      const from = this.picture, start = performance.now();
      const tick = (now) => {
        if (!this.playing) return;
        const picture = from + Math.floor(((now - start) / 1000) * data.rate);
        this.show(picture);
        if (picture >= count - 1) this.play(false); else requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    }
  }

  openVideo() {
    if (!this.video) {
      byId("screens").classList.add("alone");
      return;
    }
    byId("videoPane").hidden = false;
    this.video.src = URL.createObjectURL(
      new Blob([bytesFromBase64(byId("movie").textContent)], { type: data.movie }),
    );
    this.video.addEventListener("seeked", () => this.seeked());
    this.video.addEventListener("ended", () => { this.show(count - 1, { fromVideo: true }); this.play(false); });
    this.video.addEventListener("error", () => {
      tell("the video cannot be played by this browser; the face and the curves still can");
      this.video = null;
    });
    const follow = (_now, { mediaTime }) => {
      if (this.playing) this.show(Math.floor(mediaTime * data.rate + 1e-3), { fromVideo: true });
      this.video?.requestVideoFrameCallback?.(follow);
    };
    if (this.video.requestVideoFrameCallback) this.video.requestVideoFrameCallback(follow);
    else this.video.addEventListener("timeupdate", () => follow(0, { mediaTime: this.video.currentTime }));
  }

  fillWorst() {
    for (const { picture, region, reason } of data.worst) {
      const frame = data.frames[picture];
      const still = node("canvas", { width: 128, height: 128, "aria-hidden": "true" });
      still.getContext("2d").putImageData(this.viewer.thumbnail(this.weightsAt(picture), 128, 128), 0, 0);
      const link = node("a", { href: `#${frame}` }, still, node("span", {}, `${frame} ${region}`.trim()), node("span", {}, data.timecodes[picture] ?? ""), node("small", {}, reason));
      byId("worst").append(node("li", {}, link));
    }
    if (!data.worst.length) byId("worst").append(node("li", {}, "nothing stands out"));
  }

  plot(paths, low, high) {
    const svg = node("svg", { viewBox: `0 0 ${Math.max(count - 1, 1)} 1`, preserveAspectRatio: "none", "aria-hidden": "true" });
    if (low < 0 && high > 0) {
      const zero = (high / (high - low)).toFixed(4);
      svg.append(node("path", { class: "zero", d: `M0 ${zero}L${count - 1} ${zero}` }));
    }
    for (const [kind, d] of paths) svg.append(node("path", { class: kind, d }));
    const plot = node("div", { class: "plot" }, svg);
    const drag = (event) => {
      const box = plot.getBoundingClientRect();
      this.play(false);
      this.show(((event.clientX - box.left) / box.width) * (count - 1));
    };
    plot.addEventListener("pointerdown", (event) => { plot.setPointerCapture(event.pointerId); drag(event); });
    plot.addEventListener("pointermove", (event) => { if (event.buttons & 1) drag(event); });
    return plot;
  }

  fillStrips() {
    for (const [index, strip] of data.strips.entries()) {
      const value = (i) => strip.values[i];
      const kind = `s${index % 2}`;
      const plot = this.plot([[`fill ${kind}`, line(value, strip.low, strip.high, true)], [kind, line(value, strip.low, strip.high)]], strip.low, strip.high);
      const into = node("span", { class: "value" });
      const scale = `${strip.low.toFixed(0)}–${strip.high.toPrecision(2)} ${strip.unit}`;
      byId("strips").append(node("div", { class: "strip" }, node("span", { class: "name" }, `${strip.name} `, node("small", {}, scale)), plot, into));
      this.shown.push({ into, values: (i) => (strip.values[i] === null ? "–" : strip.values[i].toFixed(2)) });
    }
  }

  fillCurves() {
    for (const [index, { name }] of this.curves.entries()) {
      const sample = node("svg", { viewBox: "0 0 10 2", preserveAspectRatio: "none" }, node("path", { class: `s${index}`, d: "M0 1L10 1" }));
      byId("legend").append(node("li", {}, sample, name));
      byId("which").append(node("option", { value: index }, name));
    }
    let region = null;
    const order = data.shapes.map((_, i) => i).sort((a, b) => data.regions[a].localeCompare(data.regions[b]) || a - b);
    this.rows = [];
    for (const shape of order) {
      if (data.regions[shape] !== region) {
        region = data.regions[shape];
        this.rows.push({ head: true, row: byId("rows").appendChild(node("div", { class: "region" }, region)) });
      }
      const name = data.shapes[shape];
      const row = node("div", { class: "curve", "data-shape": name }, node("span", { class: "name", title: name }, name));
      byId("rows").append(row);
      let moves = false;
      for (const { values } of this.curves.slice(0, 2)) {
        for (let i = 0; i < count && !moves; i++) moves = Math.abs(values[shape * count + i]) > 0.01 * data.steps;
      }
      this.rows.push({ row, shape, name, moves, drawn: false });
    }
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries) if (entry.isIntersecting) this.drawCurve(this.rows.find(({ row }) => row === entry.target));
    }, { rootMargin: "400px" });
    for (const each of this.rows) if (!each.head) seen.observe(each.row);
    this.filter();
  }

  drawCurve(entry) {
    if (entry.drawn) return;
    entry.drawn = true;
    let low = 0, high = 1;
    const value = (values) => (i) => {
      const step = values[entry.shape * count + i];
      return step === NOTHING ? null : step / data.steps;
    };
    for (const { values } of this.curves) {
      for (let i = 0; i < count; i++) {
        const v = value(values)(i);
        if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); }
      }
    }
    const paths = this.curves.map(({ values }, index) => [`s${index}`, line(value(values), low, high)]).reverse();
    const into = node("span", { class: "value" });
    entry.row.append(this.plot(paths, low, high), into);
    const values = (i) => { const v = value(this.pose.values)(i); return v === null ? "–" : v.toFixed(3); };
    this.shown.push({ into, values });
    into.textContent = values(Math.max(this.picture, 0));
  }

  /** Show the shapes that are looked for; of those at rest only when asked. */
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
      each.row.hidden = !(each.name.toLowerCase().includes(wanted) && (each.moves || quiet || wanted));
      any ||= !each.row.hidden;
    }
  }

  fromAddress() {
    const frame = Number.parseInt(location.hash.slice(1), 10);
    if (!Number.isFinite(frame)) return;
    let best = 0;
    for (let i = 1; i < count; i++) if (Math.abs(data.frames[i] - frame) < Math.abs(data.frames[best] - frame)) best = i;
    this.play(false);
    this.show(best);
  }

  wire() {
    const scrub = byId("scrub");
    scrub.max = count - 1;
    scrub.addEventListener("input", () => { this.play(false); this.show(Number(scrub.value)); });
    byId("play").addEventListener("click", () => this.play());
    byId("back").addEventListener("click", () => { this.play(false); this.show(this.picture - 1); });
    byId("on").addEventListener("click", () => { this.play(false); this.show(this.picture + 1); });
    byId("find").addEventListener("input", () => this.filter());
    byId("quiet").addEventListener("change", () => this.filter());
    byId("which").addEventListener("change", (event) => {
      this.pose = this.curves[Number(event.target.value)];
      const at = this.picture;
      this.picture = -1;
      this.show(at, { fromVideo: true });
    });
    addEventListener("hashchange", () => this.fromAddress());
    // A link to the frame in the address changes nothing there, and still goes to it.
    addEventListener("click", (event) => { if (event.target.closest?.("a[href^='#']")) setTimeout(() => this.fromAddress()); });
    addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey) return;
      const typing = event.target.matches?.("input[type=search], select, canvas");
      const step = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity }[event.key];
      // What a space means something to keeps it; a link and the scrubber do not.
      const own = "button, input:not([type=range]), select";
      const way = { n: 1, p: -1 }[event.key];
      if (event.key === " " && !event.target.matches?.(own)) this.play();
      else if (way && !event.target.matches?.("input[type=search], select")) this.review(way);
      else if (step !== undefined && !typing && event.target !== scrub) {
        this.play(false);
        this.show(step === -Infinity ? 0 : step === Infinity ? count - 1 : this.picture + step);
      } else return;
      event.preventDefault();
    });
    addEventListener("beforeprint", () => this.keepStill());
  }

  /** A graphics context is empty on paper: put a picture in its place. */
  keepStill() {
    for (const entry of this.rows) if (!entry.head && !entry.row.hidden) this.drawCurve(entry);
    const still = byId("still");
    const image = this.viewer.thumbnail(this.weightsAt(this.picture), 640, 640);
    still.width = image.width;
    still.height = image.height;
    still.getContext("2d").putImageData(image, 0, 0);
  }
}

function tell(message) {
  byId("fault").textContent = message;
  byId("fault").hidden = false;
}

try {
  const header = JSON.parse(byId("faceHeader").textContent);
  const face = await unpackFace(header, bytesFromBase64(byId("faceData").textContent));
  const curves = [];
  for (const name of data.curves) curves.push({ name, values: await curve(name) });
  const report = new Report(face, curves);
  report.openVideo();
  report.fillWorst();
  report.fillStrips();
  report.fillCurves();
  report.wire();
  report.show(0);
  report.fromAddress();
  globalThis.report = report; // for scripts that look at the page, tests among them
  document.body.dataset.ready = "true";
} catch (error) {
  tell(`this page cannot be shown: ${error.message}`);
  throw error;
}
