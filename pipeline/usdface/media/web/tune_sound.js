// Sound around a pair's frame: continuous during playback, short grains while scrubbing.

const REACH_S = 1; // before and after the frame
const GRAIN_S = 0.12;

export class PairSound {
  constructor() {
    this.heard = []; // start times, for tests
  }

  /** Fetch a pair's sound; resolves to whether there is any. */
  async load(pair) {
    if (this.pair !== pair) {
      this.stop();
      this.pair = pair;
      this.buffer = this.#fetch(pair);
    }
    return Boolean(await this.buffer);
  }

  async #fetch(pair) {
    try {
      const response = await fetch(`/sound/${pair}.wav`);
      if (response.status !== 200) return null;
      this.context ??= new AudioContext(); // allowed after a user gesture
      return await this.context.decodeAudioData(await response.arrayBuffer());
    } catch {
      return null; // pictures play without sound
    }
  }

  /** Play from a time relative to the frame [s], by default one grain. */
  async play(after, seconds = GRAIN_S) {
    const { pair } = this;
    const buffer = await this.buffer;
    if (!buffer || this.pair !== pair) return;
    this.stop();
    this.source = new AudioBufferSourceNode(this.context, { buffer });
    this.source.connect(this.context.destination);
    this.source.start(0, Math.max(0, after + REACH_S), seconds);
    this.heard.push(after);
  }

  stop() {
    this.source?.stop();
    this.source = null;
  }
}
