// When to draw what: only after a change, never waiting for light, smooth once the camera rests.

import { ALL, LISTED } from "./renderer.js";
import { Recent } from "./sight.js";

/** @typedef {import("./camera.js").Camera} Camera */
/**
 * How a picture is drawn: at what part of its size, and whether without what has not been seen lately.
 * @typedef {{scale: number, culled: boolean}} Effort
 */
/** @typedef {Effort & {epoch: number, light: number, count: number, want: number, pair: number}} Pass */

/** @type {Effort} */
const FULL = { scale: 1, culled: false };
/** While the camera moves, the first of these that is fast enough. @type {Effort[]} */
const EFFORTS = [FULL, { scale: 1, culled: true }, { scale: 0.5, culled: true }];

const SAMPLES = 16;
const REST_MS = 180;
const SLOW_MS = 60; // a frame slower than this is drawn with less effort while the camera moves
const HOPE = 0.97; // by which a slow effort is taken to be faster, every frame that another is made in its place
const SWEEP_MS = 90; // between looks for visible particles while it moves
const MOVING_STEP = 4;
const MOVING_PIXELS = 400_000; // of a picture that is read back whole while it moves, where that saves drawing
const MOVING_PARTICLES = 2_000_000; // drawn all at once while it moves
const KEPT = 6; // sweeps of the whole picture that a particle that none has found is still drawn
const STRIDE_MAX = 64;
const SWEEP_PIXELS = 1_500_000; // of a picture that is read back whole
const LIGHT_PAUSE = 4; // frames' worth of time that a slow renderer leaves to whoever bakes, between two looks at new light
const WAYS = 10; // such pauses before it is known what lies between pixel centres
const SMOOTH_MS = 120; // time to spend on a smoother picture before new light is shown

/** @param {number} k @param {number} base */
function halton(k, base) {
  let [f, r] = [1, 0];
  for (; k > 0; k = Math.floor(k / base)) {
    f /= base;
    r += f * (k % base);
  }
  return r;
}

export class Film {
  /**
   * @param {import("./renderer.js").Renderer} renderer
   * @param {(data: Uint32Array, stride: number, epoch: number) => void} onSweep
   * @param {() => Int32Array} visible all ids that sweeps found since the camera moved
   * @param {() => boolean} awaited whether some of these have no texture yet, and it is on its way
   */
  constructor(renderer, onSweep, visible, awaited) {
    this.renderer = renderer;
    this.onSweep = onSweep;
    this.visible = visible;
    this.awaited = awaited;
    /** @type {Camera | null} */
    this.camera = null;
    this.epoch = 0;
    this.light = 0;
    this.urgent = false; // the first sample under the new light is shown at once
    this.tone = true;
    this.restAt = 0;
    /** @type {Pass | null} */
    this.pass = null;
    /** @type {Pass | null} */
    this.shown = null;
    this.sweptAt = 0;
    this.begunAt = 0;
    // Sweeps since the camera moved: of the picture without shift, and of how many shifted ones after it.
    this.central = 0;
    this.shifted = 0;
    this.listed = { central: false, all: false };
    /** How often a slow renderer may yet give way to light before the camera moves again, and until when it does now; 0 if it does not. */
    this.ways = WAYS;
    this.wayEnds = 0;
    this.recent = new Recent(0);
    this.recentStep = 1;
    this.turn = 0;
  }

  /** @param {Camera} camera */
  setCamera(camera) {
    this.camera = camera;
    // Where frames are slow, so is the next move: it must not find a full-size frame in its way.
    this.restAt = performance.now() + Math.max(REST_MS, 3 * this.renderer.frameMs);
    this.forget();
  }

  /** Light or colours changed. @param {boolean} [dragged] by something that the user drags over the picture, which must keep up */
  lightChanged(dragged = false) {
    this.light++;
    this.urgent ||= dragged;
  }

  /** Exposure or background changed. */
  toneChanged() {
    this.tone = true;
  }

  /** Canvas or particles changed: nothing drawn is of use. */
  restart() {
    if (this.recent.seen.length !== this.renderer.count) this.recent = new Recent(this.renderer.count);
    this.pass = null;
    this.shown = null;
    this.forget();
  }

  forget() {
    this.epoch++;
    this.central = 0;
    this.shifted = 0;
    this.listed = { central: false, all: false };
    this.ways = WAYS;
    this.wayEnds = 0;
  }

  get restStep() {
    return this.renderer.canvas.width * this.renderer.canvas.height <= SWEEP_PIXELS ? 1 : 2;
  }

  /** Whether all that the rays through pixel centres meet is known. */
  get centralKnown() {
    return this.central >= this.restStep ** 2;
  }

  /** Whether all that is visible, between the pixel centres too, is known. */
  get settled() {
    return this.centralKnown && this.shifted >= SAMPLES - 1 && !this.renderer.readback.pending;
  }

  /** Draw the next piece. @returns {boolean} whether there is more to do */
  step() {
    const { renderer, camera } = this;
    if (camera === null || renderer.spheres === null) return false;
    const found = renderer.readback.poll();
    if (found !== null) {
      this.recent.collect(found.data, found.stride, KEPT * this.recentStep ** 2);
      this.onSweep(found.data, found.stride, found.tag);
    }
    this.learn();
    const now = performance.now();
    const moving = now < this.restAt;
    if (renderer.busy) return true;
    const effort = moving ? this.effort() : FULL;
    let pass = this.pass;
    // Drawing by software takes the very cores that light comes from: first know what is visible, then look now and then.
    const slow = renderer.frameMs > SLOW_MS && pass !== null && pass.light !== this.light;
    const pausing = slow && this.settled && now < this.begunAt + LIGHT_PAUSE * renderer.frameMs;
    if (pass === null || pass.epoch !== this.epoch || pass.scale < effort.scale || (pass.culled && !effort.culled)) {
      pass = this.begin(effort, 1);
    } else if (!moving && pass.count > 1 && !this.centralKnown) {
      // Drawn before the camera rested, so that nobody looked at the ids of the sample without shift: begin again.
      pass = this.begin(FULL, Math.min(8, pass.count));
    } else if (this.urgent && pass.light !== this.light) {
      pass = this.begin(pass, 1);
    } else if (pausing) {
      return true;
    } else if (!moving && this.givesWay(now)) {
      if (now < this.wayEnds) return true;
      this.wayEnds = 0;
      if (pass.light !== this.light) pass = this.begin(FULL, 1);
    } else if (!(slow && !this.settled) && pass.light !== this.light && pass.count >= pass.want) {
      pass = this.begin(pass, Math.max(1, Math.min(8, Math.floor(SMOOTH_MS / renderer.frameMs))));
    }
    const shape = this.shape(pass);
    let drew = false;
    // At rest, every sample has to be swept once before the next one takes its place.
    if (pass.count < (pass.culled ? 1 : SAMPLES) && (moving || !this.owed(pass))) {
      const k = pass.count++;
      const shift = k === 0 ? [0, 0] : [halton(k, 2) - 0.5, halton(k, 3) - 0.5];
      const listed = k === 0 ? this.listed.central : this.listed.all;
      renderer.drawSample(camera, shift, shape, pass.pair, k === 0, pass.culled ? this.cull() : listed ? LISTED : ALL);
      drew = true;
      if (pass.count >= pass.want) {
        this.shown = pass;
        this.tone = true;
      }
    }
    if (this.tone && this.shown !== null) {
      renderer.present(this.shown.pair, this.shown.count, this.shape(this.shown));
      this.tone = false;
    }
    if (drew) renderer.endFrame(kind(pass, this.listed.central));
    this.sweep(pass, shape, moving, now);
    return drew || moving || pass.count < SAMPLES || pass.light !== this.light || !this.settled || renderer.frames.length > 0;
  }

  /**
   * Whether a slow renderer gives way to light, now and then from when it is known what rays through pixel centres meet until that is lit. To look for what lies
   * between them takes many frames, for which nobody should look at a picture without light.
   * @param {number} now
   */
  givesWay(now) {
    const { frameMs, readback } = this.renderer;
    if (!this.wayEnds && this.ways && frameMs > SLOW_MS && this.centralKnown && !readback.pending) {
      if (this.awaited()) {
        this.ways--;
        this.wayEnds = now + LIGHT_PAUSE * frameMs;
      } else {
        this.ways = 0; // the few that are found later are lit soon enough
      }
    }
    return this.wayEnds > 0;
  }

  /** What there is time for while the camera moves. */
  effort() {
    const { times, loaded } = this.renderer;
    for (const effort of EFFORTS.slice(0, -1)) {
      if (!effort.culled && loaded > MOVING_PARTICLES) continue;
      const name = kind(effort, false), took = times.get(name) ?? 0;
      if (took <= SLOW_MS) return effort;
      times.set(name, took * HOPE); // so that it is tried again some time
    }
    return EFFORTS[EFFORTS.length - 1];
  }

  /** What was seen lately, and a part of the rest, so that what comes into sight is found within some frames. @returns {import("./renderer.js").Drawn} */
  cull() {
    const { ids } = this.recent, { loaded } = this.renderer;
    this.renderer.setList(ids);
    const stride = Math.max(2, Math.min(STRIDE_MAX, Math.round(loaded / Math.max(4096, ids.length))));
    return { listed: true, first: this.turn++ % stride, stride, filtered: false };
  }

  /** Look at the ids of the sample just drawn, if there is something to learn from it. @param {Pass} pass @param {import("./renderer.js").Shape} shape @param {boolean} moving @param {number} now */
  sweep(pass, shape, moving, now) {
    if (this.renderer.readback.pending) return;
    if (moving && pass.culled) {
      this.recentStep = [1, 2].find((step) => shape.width * shape.height <= MOVING_PIXELS * step * step) ?? MOVING_STEP;
      this.renderer.sweep(shape, this.recentStep, this.turn);
    } else if (moving) {
      if (now - this.sweptAt > SWEEP_MS && this.renderer.sweep(shape, MOVING_STEP, Math.floor(now))) this.sweptAt = now;
    } else if (this.owed(pass)) {
      const turn = pass.count === 1 ? this.central++ : this.shifted++;
      this.recentStep = this.restStep;
      this.renderer.sweep(shape, this.restStep, turn);
    }
  }

  /** Whether the sample drawn last has to be swept before the next is drawn. @param {Pass} pass */
  owed(pass) {
    if (pass.epoch !== this.epoch || pass.scale < 1 || pass.culled || pass.count === 0) return false;
    return pass.count === 1 ? !this.centralKnown : this.shifted < pass.count - 1;
  }

  /** What is hidden need not be drawn again before the camera moves. */
  learn() {
    if (this.renderer.readback.pending) return;
    if (this.settled ? !this.listed.all : this.centralKnown && this.shifted === 0 && !this.listed.central) {
      this.listed = { central: true, all: this.settled };
      this.renderer.setList(this.visible());
    }
  }

  /** @param {Pass} pass */
  shape(pass) {
    const { width, height } = this.renderer.canvas;
    return { width: Math.max(1, Math.floor(width * pass.scale)), height: Math.max(1, Math.floor(height * pass.scale)), epoch: pass.epoch };
  }

  /** @param {Effort} effort @param {number} want samples before it replaces what is on screen @returns {Pass} */
  begin({ scale, culled }, want) {
    const pair = this.shown === null ? 0 : 1 - this.shown.pair;
    this.begunAt = performance.now();
    this.urgent = false;
    this.pass = { epoch: this.epoch, light: this.light, scale, culled, count: 0, want, pair };
    return this.pass;
  }
}

/** Names what a frame's time depends on. @param {Effort} effort @param {boolean} listed */
const kind = ({ scale, culled }, listed) => `${culled ? "culled" : listed ? "listed" : "all"} ${scale}`;
