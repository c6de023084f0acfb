// The tuning page: connects face, sliders, pairs and server.

import { FaceViewer, bytesFromBase64, unpackFace } from "./face_viewer.js";
import { node } from "./elements.js";
import { FilmStrip } from "./tune_film.js";
import { Outbox, post } from "./tune_outbox.js";
import { PoseDialog } from "./tune_poses.js";
import { PlacementTool } from "./tune_placement.js";
import { oneTabStop } from "./tab_stops.js";
import { Residual, ResidualTable } from "./tune_residual.js";
import { ShapePanel } from "./tune_shapes.js";
import { TuneState } from "./tune_state.js";
import { VideoPane } from "./tune_video.js";
import { Wipe } from "./tune_wipe.js";

const $ = (id) => document.getElementById(id);
const floats = (text) => new Float32Array(bytesFromBase64(text).buffer);

async function ask(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(`${path}: ${await response.text()}`);
  return response;
}

async function readState() {
  const sent = await (await ask("/state.json")).json();
  return { ...sent, weights: floats(sent.weights), proposals: floats(sent.proposals) };
}

async function main() {
  const [known, sent] = await Promise.all([ask("/face.json").then((r) => r.json()), readState()]);
  const own = known.columns.map((column) => known.face.shapes[column]);
  const pick = (key) => own.map((shape) => shape[key]);
  const state = new TuneState(
    { names: pick("name"), low: pick("low"), high: pick("high"), mirror: known.mirror, sided: known.sided },
    known.pairs,
  );
  state.load(sent);
  const outbox = new Outbox(state, known.name);
  outbox.revision = sent.revision;
  const recovered = outbox.recover();
  const page = new Page(known, state, outbox, pick("region"));
  if (recovered) page.tell(`${recovered} unsent values of an earlier session were restored`);
  globalThis.tune = page; // for tests
  state.go(known.first);
  const markers = ask("/markers.json"); // the server places them while the face is fetched
  markers.catch(() => {});
  await page.loadFace();
  await page.loadMarkers(await markers);
}

class Page {
  constructor(known, state, outbox, regions) {
    Object.assign(this, { known, state, outbox });
    this.weights = new Float32Array(known.face.shapes.length);
    this.showMarkers = true;
    this.showLabels = false;
    this.showProposal = false;
    this.picking = false;
    $("asset").textContent = known.name;
    $("rig").textContent = known.rig;
    document.title = `${known.name} · tune`;
    this.panel = new ShapePanel(
      $("shapes"),
      state,
      regions,
      (shape) => this.viewer?.highlight(shape === null ? null : known.columns[shape]),
      {
        Solve: {
          title: "Solve this part for the markers; sliders set by hand are kept",
          act: (shapes, part) => this.solve(shapes, part),
        },
        "Copy…": {
          title: "Copy this part from another pair",
          act: (shapes, part) => this.choose(true, shapes, part),
        },
      },
    );
    this.poses = new PoseDialog($("poseDialog"), this.panel.groups.map((group) => group.region));
    this.poses.addEventListener("save", ({ detail: { name } }) => this.keepPose(name, this.posed()));
    this.poses.addEventListener("remove", ({ detail: { name } }) => this.keepPose(name, null));
    this.poses.addEventListener("apply", ({ detail }) => this.applyPose(detail));
    this.panel.offer("Solve", false); // until the markers are loaded
    this.film = new FilmStrip($("film"), state, (pair) => this.pick(pair));
    this.wiping = new Wipe($("wipePicture"), $("wipeLine"));
    const pictures = [$("picture"), $("wipePicture").firstChild];
    this.video = new VideoPane(pictures, $("noPicture"), $("videoNote"), $("videoAfter"), $("videoPlay"));
    $("wipe").disabled = known.pairs.every((pair) => pair.noPicture);
    if ($("wipe").disabled) document.querySelector("main").classList.add("noVideo");
    state.addEventListener("weights", ({ detail: { pair } }) => {
      if (pair === state.current) this.pose();
      this.buttons();
    });
    state.addEventListener("done", () => {
      this.pose();
      this.buttons();
    });
    state.addEventListener("pair", () => this.arrive());
    outbox.addEventListener("status", ({ detail: { kind, text } }) => {
      $("saved").className = kind;
      $("saved").textContent = text;
      $("saved").title = text;
    });
    outbox.addEventListener("outdated", ({ detail: { resolve } }) => this.catchUp().finally(resolve));
    addEventListener("beforeunload", (event) => {
      if (!outbox.isEmpty) event.preventDefault();
    });
    this.wire();
    document.querySelectorAll("#bar, .strip, #shapes details, #film").forEach((part) => oneTabStop(part));
    if (outbox.isEmpty) $("saved").textContent = "saved";
  }

  async loadFace() {
    const face = await unpackFace(this.known.face, await (await ask("/face.bin")).arrayBuffer());
    this.viewer = new FaceViewer($("view"), face);
    $("veil").hidden = true;
    this.pose();
    this.film.start((pair, width, height) =>
      this.viewer.thumbnail(this.onRig(this.state.row(pair)), width, height),
    );
  }

  async loadMarkers(response) {
    const markers = await response.json();
    $("markers").removeAttribute("aria-busy");
    $("markers").disabled = $("labels").disabled = Boolean(markers.reason);
    $("placeMarkers").disabled = !markers.placement;
    if (markers.reason) {
      $("markers").setAttribute("aria-pressed", false);
      $("markers").title = `No markers: ${markers.reason}`;
      this.tell(`No residual: ${markers.reason}`);
      return;
    }
    this.unpackMarkers(markers);
    this.panel.offer("Solve", true);
    this.table = new ResidualTable($("residual").firstElementChild, this.residual.parts);
    const off = (pair) => this.residual.measure(this.onRig(this.state.row(pair)), pair);
    this.film.measure(off, this.residual.parts, $("sieve"));
    if (markers.placement) {
      this.placing = new PlacementTool(this.viewer, markers);
      this.placing.addEventListener("placed", ({ detail }) => this.place(detail));
    } else $("placeMarkers").title = "These references have no placement; select again to get one";
    this.pose();
  }

  unpackMarkers(markers) {
    for (const key of ["rest", "keyDeltas", "targets"]) markers[key] = floats(markers[key]);
    this.residual = new Residual(this.viewer.face, markers);
  }

  /** Send the new position of a marker; the answer holds the positions of all. */
  async place(dropped) {
    const answer = await post("/place", dropped);
    if (answer.reason) {
      this.placing.load(this.residual);
      this.tell(`${dropped.marker} is not moved: ${answer.reason}`);
    } else {
      this.unpackMarkers(answer);
      this.placing.load(answer);
      const what = dropped.at ? "corrected" : "reset to the proposal";
      this.tell(`${dropped.marker} is ${what} (${answer.placement}). Select again to update the other markers and the proposals`);
    }
    this.pose();
  }

  /** Solve a part's shapes for the markers, except those set by hand. */
  async solve(shapes, part) {
    const { state } = this;
    const { current: pair, names } = state;
    const held = state.touched(shapes);
    const free = shapes.filter((shape) => !held.includes(shape));
    if (!free.length) return this.tell(`Every slider of the ${part} is set by hand; reset those to solve`);
    this.tell(`Solving the ${part} …`, 0);
    const weights = this.posed();
    const answer = await post("/solve", { pair, weights, free: free.map((shape) => names[shape]) });
    if (answer.reason) return this.tell(`The ${part} is not solved: ${answer.reason}`);
    const still = free.filter((shape) => state.row(pair)[shape] === weights[names[shape]]);
    state.putSolved(new Map(still.map((shape) => [shape, answer.weights[names[shape]]])), pair);
    const which = held.map((shape) => names[shape]);
    this.tell(`The ${part} is solved for the markers${held.length ? `; kept: ${which.join(", ")}` : ""}`);
  }

  togglePlacing() {
    if (!this.placing) return;
    this.placing.on = !this.placing.on;
    $("placeMarkers").setAttribute("aria-pressed", this.placing.on);
    document.querySelector("#face").classList.toggle("placing", this.placing.on);
    if (this.placing.on) this.tell("Drag a marker to its position on the performer; double click resets it; K ends", 0);
    else this.hush();
    this.pose();
  }

  /** Weights of the references in the order of the rig's shapes. */
  onRig(row) {
    this.weights.fill(0);
    this.known.columns.forEach((column, shape) => {
      this.weights[column] = row[shape];
    });
    return this.weights;
  }

  pose() {
    const { viewer, state, residual } = this;
    if (!viewer) return;
    if (this.placing?.on) {
      $("residual").hidden = true;
      viewer.setMarkers(this.placing.overlay());
      viewer.setWeights(new Float32Array(this.weights.length));
      return;
    }
    const shown = this.showProposal ? state.proposal() : state.row();
    if (residual) {
      const isKey = !this.showProposal && state.isTuned(state.current);
      const distances = residual.measure(this.onRig(shown), state.current, isKey);
      this.table.show(distances, isKey);
      this.millimetres = distances.get("");
      $("residual").hidden = !this.showMarkers || this.wiping.on;
      viewer.setMarkers(this.showMarkers ? residual.overlay(state.current, this.showLabels) : null);
    }
    viewer.setWeights(this.onRig(shown));
  }

  arrive() {
    const { state } = this;
    const pair = state.pairs[state.current];
    $("number").textContent = state.current + 1;
    $("total").textContent = ` / ${state.pairs.length}`;
    const facts = [`frame ${pair.frame}`, pair.take, pair.viseme, pair.emotion].filter(Boolean);
    $("facts").textContent = $("facts").title = facts.join(" · ");
    $("remarks").replaceChildren(...pair.notes.map((text) => node("li", {}, text)));
    this.video.show(state.current, state.pairs);
    if (this.wiping.on) this.matchCamera();
    this.film.paint();
    this.pose();
    this.buttons();
  }

  buttons() {
    const { state } = this;
    $("undo").disabled = !state.past.length;
    $("redo").disabled = !state.future.length;
    $("reset").disabled = !state.changed().length;
    $("done").setAttribute("aria-pressed", state.done[state.current]);
    $("previous").disabled = state.current === 0;
    $("next").disabled = state.current === state.pairs.length - 1;
    const done = state.done.filter(Boolean).length;
    $("progress").textContent = `${done} of ${state.pairs.length} done`;
  }

  step(by) {
    this.state.go(this.state.current + by);
  }

  toggleDone(onward) {
    const { state } = this;
    state.setDone(onward || !state.done[state.current]);
    if (!onward) return;
    const count = state.pairs.length;
    const rest = [...Array(count).keys()].map((k) => (state.current + 1 + k) % count);
    const next = rest.find((pair) => !state.done[pair]);
    if (next === undefined) this.tell("all pairs are done");
    else state.go(next);
  }

  toggle(id, key) {
    this[key] = !this[key];
    $(id).setAttribute("aria-pressed", this[key]);
    this.pose();
  }

  hold(on) {
    if (this.showProposal === on) return;
    this.showProposal = on;
    $("before").setAttribute("aria-pressed", on);
    this.pose();
  }

  link() {
    this.state.linked = !this.state.linked;
    $("link").setAttribute("aria-pressed", this.state.linked);
  }

  /** The current pair's weights by name. */
  posed() {
    return Object.fromEntries(this.state.names.map((name, shape) => [name, this.state.row()[shape]]));
  }

  async openPoses() {
    this.poses.open();
    const answer = await fetch("/poses.json").then((sent) => sent.json(), () => ({ reason: "the server does not answer" }));
    if (answer.poses) return this.poses.show(answer.poses);
    this.poses.close();
    this.tell(`No poses: ${answer.reason}`);
  }

  async keepPose(name, weights) {
    const answer = await post("/poses", { name, weights });
    if (answer.reason) this.tell(`The poses are not changed: ${answer.reason}`);
    else this.poses.show(answer.poses);
  }

  applyPose({ name, part }) {
    const { state } = this;
    const pose = this.poses.poses[name];
    const group = this.panel.groups.find((each) => each.region === part);
    state.endGesture();
    const shapes = group?.shapes ?? [...state.names.keys()];
    state.set(new Map(shapes.map((shape) => [shape, pose[state.names[shape]] ?? 0])));
    this.tell(`${name} is applied to ${group ? `the ${part || "other shapes"}` : "the whole face"}; Ctrl+Z undoes it`);
  }

  /** Start or end the choice of a pair to copy all shapes, or a part's, from. */
  choose(on = !this.picking, shapes = undefined, part = "face") {
    this.picking = on;
    this.copied = shapes;
    $("film").classList.toggle("picking", on);
    if (on) this.tell(`Click the pair to copy the ${part} from; Esc cancels`, 0);
    else this.hush();
  }

  pick(pair) {
    if (this.picking) {
      const shapes = this.copied;
      this.choose(false);
      this.state.copyFrom(pair, shapes);
    } else this.state.go(pair);
  }

  async catchUp() {
    const sent = await readState();
    this.state.load(sent);
    this.outbox.revision = sent.revision;
    this.outbox.overlay();
    this.film.refresh();
    this.panel.paint();
    this.pose();
    this.buttons();
    this.tell("The weights were changed elsewhere; your changes were applied to them");
  }

  tell(text, seconds = 6) {
    this.hush();
    $("message").textContent = $("message").title = text;
    if (seconds) this.noteTimer = setTimeout(() => this.hush(), 1000 * seconds);
  }

  hush() {
    clearTimeout(this.noteTimer);
    $("message").textContent = $("message").title = "";
  }

  toggleVideo() {
    document.querySelector("main").classList.toggle("noVideo");
  }

  toggleWipe() {
    if ($("wipe").disabled) return;
    this.wiping.show(!this.wiping.on);
    $("wipe").setAttribute("aria-pressed", this.wiping.on);
    this.pose();
    if (this.wiping.on) {
      this.matchCamera();
      this.tell("Wheel and drag align the video with the face, for all pairs; double click resets it; W ends");
    } else {
      this.view(0);
      this.hush();
    }
  }

  /** Turn the view as the performer's head relative to the neutral frame; frontal if unknown. */
  matchCamera() {
    const [yaw, pitch, roll] = this.state.pairs[this.state.current].head ?? [0, 0, 0];
    this.viewer?.resetView(-yaw, pitch, -roll);
  }

  view(yaw) {
    this.viewer?.resetView(yaw, yaw ? 4 : 0);
  }

  wire() {
    const { state } = this;
    const clicks = {
      previous: () => this.step(-1),
      next: () => this.step(1),
      undo: () => state.undo(),
      redo: () => state.redo(),
      mirror: () => state.mirrorPair(),
      copy: () => this.choose(),
      reset: () => state.reset(),
      poses: () => this.openPoses(),
      done: () => this.toggleDone(false),
      markers: () => this.toggle("markers", "showMarkers"),
      labels: () => this.toggle("labels", "showLabels"),
      placeMarkers: () => this.togglePlacing(),
      link: () => this.link(),
      frame: () => this.viewer?.frameFace(),
      videoFit: () => this.video.fit(),
      wipe: () => this.toggleWipe(),
      help: () => $("keys").showModal(),
    };
    for (const [id, action] of Object.entries(clicks)) $(id).addEventListener("click", action);
    for (const button of document.querySelectorAll("[data-yaw]")) {
      button.addEventListener("click", () => this.view(Number(button.dataset.yaw)));
    }
    for (const button of document.querySelectorAll("[data-show]")) {
      button.addEventListener("click", () => {
        for (const each of document.querySelectorAll("[data-show]")) {
          each.setAttribute("aria-pressed", each === button);
        }
        this.panel.show(button.dataset.show);
      });
    }
    $("search").addEventListener("input", () => this.panel.find($("search").value));
    $("search").addEventListener("keydown", (event) => { if (event.key === "Enter") this.panel.enter(); });
    $("sieve").addEventListener("change", ({ target }) => {
      this.film.sieve(target.value);
      this.pose(); // measuring other pairs has overwritten the colours
      target.blur();
    });
    $("before").addEventListener("pointerdown", () => this.hold(true));
    for (const name of ["pointerup", "pointercancel", "blur"]) {
      addEventListener(name, () => this.hold(false));
    }
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("keyup", (event) => {
      if (event.key.toLowerCase() === "b") this.hold(false);
    });
  }

  key(event) {
    const { state } = this;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (event.altKey || $("keys").open || this.poses.isOpen) return;
    if (event.ctrlKey || event.metaKey) {
      if (key === "z") event.shiftKey ? state.redo() : state.undo();
      else if (key === "y") state.redo();
      else return;
      event.preventDefault();
      return;
    }
    const into = event.target;
    if (key === "Escape") {
      if (into === $("search")) {
        $("search").value = "";
        this.panel.find("");
      }
      into.blur?.();
      this.choose(false);
      if (this.placing?.on) this.togglePlacing();
      return;
    }
    if (into.matches?.('input:not([type="range"]), select')) return;
    if (key === " " && into.matches?.("button, summary")) return;
    const actions = {
      n: () => this.step(1),
      p: () => this.step(-1),
      PageDown: () => this.step(1),
      PageUp: () => this.step(-1),
      ArrowRight: () => this.step(1),
      ArrowLeft: () => this.step(-1),
      d: () => this.toggleDone(event.shiftKey),
      m: () => state.mirrorPair(),
      r: () => state.reset(),
      c: () => this.choose(),
      l: () => this.link(),
      s: () => this.openPoses(),
      b: () => this.hold(true),
      o: () => this.toggle("markers", "showMarkers"),
      i: () => this.toggle("labels", "showLabels"),
      k: () => this.togglePlacing(),
      v: () => this.toggleVideo(),
      w: () => this.toggleWipe(),
      " ": () => this.video.play(),
      f: () => this.viewer?.frameFace(),
      1: () => this.view(0),
      2: () => this.view(35),
      3: () => this.view(-35),
      4: () => this.view(90),
      "/": () => $("search").focus(),
      "?": () => $("keys").showModal(),
    };
    if (!(key in actions)) return;
    event.preventDefault();
    if (key === "b" && event.repeat) return;
    actions[key]();
  }
}

main().catch((error) => {
  $("veil").className = "bad";
  $("veil").textContent = `The page could not be loaded: ${error.message}`;
  $("saved").textContent = "";
});
