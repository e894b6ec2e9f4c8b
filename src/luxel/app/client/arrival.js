// Data sets that come part by part: an evenly spread beginning first, then as much more as this browser can take. Small ones
// come by themselves, all at once, and have nothing to do with this.

import { KIND, encode } from "./protocol.js";
import { PARTICLES_WIDTH } from "./renderer.js";

/** @typedef {import("./app.js").App} App */
/** @typedef {{values: Float32Array, have: number, given: boolean, head: any}} Partial */
/** @typedef {{name: string | null, start: number, count: number}} Part of a scalar, or of the particles */

const PART = 1 << 18; // particles that are asked for at a time
const ASKED_MAX = 3; // parts on their way
const GROWTH = 1.5; // of what is here, between two looks at how long it takes to draw
const SLOW_MS = 250; // that all particles take to draw: beyond, there is nothing interactive about it
const PARTICLE_BYTES = 100; // in the page's memory and the graphics processor's
const MEMORY_SHARE = 1 / 8; // of the machine's
const MEMORY_GIB = 4; // of machines that do not say

export class Arrival {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** Most particles, as the user wants it; 0 leaves it to what is measured. */
    this.limit = 0;
    /** Particles that there is room for. */
    this.room = 0;
    /** Particles to have before it is decided about more. */
    this.target = 0;
    /** What to ask for next. @type {Part[]} */
    this.parts = [];
    /** Names and places of parts on their way. @type {Set<string>} */
    this.asked = new Set();
    /** Scalars that are asked for. @type {Map<string, Partial>} */
    this.scalars = new Map();
    this.input = app.element("most");
    this.input.addEventListener("change", () => this.limitChanged());
  }

  /** Whether particles are asked for. */
  get active() {
    return this.room > 0;
  }

  /** Whether all is here that will come. */
  get done() {
    return !this.waiting && (this.target === this.room || this.slow);
  }

  /** Whether something was asked for that has not come. */
  get waiting() {
    return this.parts.length > 0 || this.asked.size > 0;
  }

  /** Whether more particles would be too slow to draw. */
  get slow() {
    const { count, ms } = this.app.drawing.renderer.whole;
    return this.limit === 0 && count === this.target && ms * GROWTH > SLOW_MS;
  }

  /** Another data set. @param {any} scene @returns {number} particles to make room for */
  reset(scene) {
    const { app } = this;
    this.parts = [];
    this.asked.clear();
    this.room = this.target = 0;
    this.scalars.clear();
    app.element("most-row").hidden = !scene.first;
    if (!scene.first) return scene.streamed ? 0 : scene.count;
    const memory = /** @type {{deviceMemory?: number}} */ (navigator).deviceMemory ?? MEMORY_GIB;
    const fits = Math.floor((memory * MEMORY_SHARE * 2 ** 30) / PARTICLE_BYTES);
    this.room = Math.min(scene.count, this.limit || Math.max(scene.first, fits), app.drawing.renderer.particlesMax);
    this.grow(Math.min(scene.first, this.room));
    return this.room;
  }

  /** Plan to have `target` particles. @param {number} target */
  grow(target) {
    for (let start = this.target; start < target; start += PART) {
      const count = Math.min(PART, target - start);
      for (const name of this.scalars.keys()) this.parts.push({ name, start, count }); // first, so that none is drawn without
      this.parts.push({ name: null, start, count });
    }
    this.target = target;
  }

  /** Ask for all there is here of a scalar. @param {string} name */
  askFor(name) {
    const wanted = [];
    for (let start = 0; start < this.target; start += PART) wanted.push({ name, start, count: Math.min(PART, this.target - start) });
    this.parts.unshift(...wanted);
    this.scalars.set(name, { values: new Float32Array(this.room).fill(NaN), have: 0, given: false, head: null });
    this.next();
  }

  /** Ask for the next parts. */
  next() {
    const { connection, scene } = this.app;
    while (this.asked.size < ASKED_MAX && this.parts.length) {
      const { name, start, count } = /** @type {Part} */ (this.parts.shift());
      this.asked.add(`${name} ${start}`);
      if (name === null) connection.send(encode(KIND.geometryRequest, { epoch: scene.epoch, start, count }));
      else connection.send(encode(KIND.scalarRequest, { name, start, count }));
    }
  }

  /** A part has come. @param {string | null} name of a scalar @param {number} start @returns {boolean} whether it was asked for */
  took(name, start) {
    const known = this.asked.delete(`${name} ${start}`);
    this.next();
    return known;
  }

  /**
   * Take in a part of a scalar.
   * @param {any} head @param {Float32Array} values
   * @returns {Partial | null} the scalar, once it has come as far as it was asked for; what comes later is just added
   */
  takeScalar(head, values) {
    const known = this.took(head.name, head.start), partial = this.scalars.get(head.name);
    if (!known || partial === undefined) return null;
    if (head.start === 0) partial.head = head;
    partial.values.set(values, head.start);
    partial.have = head.start + values.length;
    if (partial.given || partial.have < this.loaded) return null;
    partial.given = true;
    return partial;
  }

  get loaded() {
    return this.app.spheres.shown.loaded;
  }

  /** A frame was drawn: if that went fast, more can come. */
  tick() {
    const { app } = this;
    if (!this.active || this.waiting || this.target === this.room) return;
    if (app.drawing.renderer.whole.count !== this.target || this.slow) return;
    const rows = Math.ceil((this.target * GROWTH) / PARTICLES_WIDTH);
    this.grow(this.limit ? this.room : Math.min(this.room, rows * PARTICLES_WIDTH));
    this.next();
  }

  /** The user wants another number. */
  limitChanged() {
    const wanted = this.input.valueAsNumber;
    this.limit = wanted > 0 ? Math.round(wanted) : 0;
    if (!this.limit) this.input.value = "";
    this.app.introduce(); // all comes anew, into as much room
  }

  /** What the status line says. @returns {string | null} */
  get text() {
    const { scene } = this.app, { loaded } = this;
    if (!this.active || loaded === scene.count) return null;
    const n = (/** @type {number} */ x) => x.toLocaleString("en");
    const why = !this.done ? "" : this.limit ? ", as you wish" : this.slow ? ", as many as this browser draws fast" : ", as many as there is memory for";
    return `${n(loaded)} of ${n(scene.count)} particles${why}`;
  }
}
