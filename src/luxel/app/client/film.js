// When to draw what: only after a change, never waiting for light, smooth once the camera rests.

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {{epoch: number, light: number, scale: number, count: number, want: number, pair: number}} Pass */

const SAMPLES = 16;
const REST_MS = 180;
const SLOW_MS = 60; // a frame slower than this is drawn smaller while the camera moves
const SWEEP_MS = 90; // between looks for visible particles while it moves
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
  /** @param {import("./renderer.js").Renderer} renderer @param {(data: Uint32Array, stride: number, epoch: number) => void} onSweep */
  constructor(renderer, onSweep) {
    this.renderer = renderer;
    this.onSweep = onSweep;
    /** @type {Camera | null} */
    this.camera = null;
    this.epoch = 0;
    this.light = 0;
    this.tone = true;
    this.restAt = 0;
    /** @type {Pass | null} */
    this.pass = null;
    /** @type {Pass | null} */
    this.shown = null;
    this.swept = 0;
    this.sweptAt = 0;
  }

  /** @param {Camera} camera */
  setCamera(camera) {
    this.camera = camera;
    this.epoch++;
    this.swept = 0;
    this.restAt = performance.now() + REST_MS;
  }

  /** Light, colours or particles changed. */
  lightChanged() {
    this.light++;
  }

  /** Exposure or background changed. */
  toneChanged() {
    this.tone = true;
  }

  /** The canvas changed its size: nothing drawn is left. */
  restart() {
    this.pass = null;
    this.shown = null;
    this.epoch++;
    this.swept = 0;
  }

  get sweepStep() {
    const { width, height } = this.renderer.canvas;
    return width * height <= 120_000 ? 1 : width * height <= 500_000 ? 2 : 4;
  }

  /** Whether all that is visible has been looked at since the camera moved. */
  get settled() {
    return this.swept >= this.sweepStep ** 2 && !this.renderer.readback.pending;
  }

  /** Draw the next piece. @returns {boolean} whether there is more to do */
  step() {
    const { renderer, camera } = this;
    if (camera === null || renderer.spheres === null) return false;
    const found = renderer.readback.poll();
    if (found !== null) this.onSweep(found.data, found.stride, found.tag);
    if (renderer.busy) return true;
    const moving = performance.now() < this.restAt;
    const { width, height } = renderer.canvas;
    const fullMs = renderer.frameMs * (width * height) / renderer.framePixels;
    const scale = moving && fullMs > SLOW_MS ? 0.5 : 1;
    let pass = this.pass;
    if (pass === null || pass.epoch !== this.epoch || pass.scale < scale) {
      pass = this.begin(scale, 1);
    } else if (pass.light !== this.light && pass.count >= pass.want) {
      pass = this.begin(pass.scale, Math.max(1, Math.min(8, Math.floor(SMOOTH_MS / renderer.frameMs))));
    }
    const shape = {
      width: Math.max(1, Math.floor(width * pass.scale)), height: Math.max(1, Math.floor(height * pass.scale)), epoch: this.epoch,
    };
    const drawing = pass.count < SAMPLES;
    if (drawing) {
      const k = pass.count++;
      const shift = k === 0 ? [0, 0] : [halton(k, 2) - 0.5, halton(k, 3) - 0.5];
      renderer.drawSample(camera, shift, shape, pass.pair, k === 0);
      const now = performance.now();
      if (this.swept < this.sweepStep ** 2 + SAMPLES && (!moving || now - this.sweptAt > SWEEP_MS)) {
        if (renderer.sweep(shape, this.sweepStep, this.swept)) {
          this.swept++;
          this.sweptAt = now;
        }
      }
      if (pass.count >= pass.want) {
        this.shown = pass;
        this.tone = true;
      }
    }
    if (this.tone && this.shown !== null) {
      const { scale: s } = this.shown;
      renderer.present(this.shown.pair, this.shown.count, { ...shape, width: Math.floor(width * s), height: Math.floor(height * s) });
      this.tone = false;
    }
    if (drawing) renderer.endFrame(shape.width * shape.height);
    if (!drawing && !this.settled && !renderer.readback.pending) {
      this.swept += renderer.sweep(shape, this.sweepStep, this.swept) ? 1 : 0;
    }
    return pass.count < SAMPLES || moving || pass.light !== this.light || !this.settled || renderer.frames.length > 0;
  }

  /** @param {number} scale @param {number} want samples before it replaces what is on screen @returns {Pass} */
  begin(scale, want) {
    const pair = this.shown === null ? 0 : 1 - this.shown.pair;
    this.pass = { epoch: this.epoch, light: this.light, scale, count: 0, want, pair };
    return this.pass;
  }
}
