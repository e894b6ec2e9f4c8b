// Which particles are hidden, and the spheres as the picture has them: radii scaled, none where hidden. Knows nothing of WebGL.

import { DirtyRows } from "./tiles.js";

/** @typedef {{kind: "cut", normal: number[], offset: number}} Cut hides centres beyond the plane, in file units */
/** @typedef {{kind: "select", scalar: string, low: number | null, high: number | null}} Select hides what is outside the range */
/** @typedef {Cut | Select} Condition */
/** @typedef {{center: number[], unit: number, bounds: [number[], number[]]}} Space normalised units, as in the scene message */

const TOLERANCE = 1e-6; // of the diagonal, as in luxel.scene.hiding

/** The ends of the data along a direction, in file units. @param {Space} space @param {number[]} normal @returns {[number, number]} */
export function extent({ center, unit, bounds }, normal) {
  let [low, high] = [0, 0];
  normal.forEach((n, k) => {
    const ends = [n * (center[k] + unit * bounds[0][k]), n * (center[k] + unit * bounds[1][k])];
    low += Math.min(...ends);
    high += Math.max(...ends);
  });
  return [low, high];
}

export class Shown {
  /** @param {number} count particles @param {number} width particles in a row of the texture */
  constructor(count, width) {
    this.count = count;
    this.width = width;
    /** Centre and radius of every particle, as in the file. */
    this.spheres = new Float32Array(4 * count);
    /** The same as it is drawn. */
    this.drawn = new Float32Array(4 * count);
    this.hidden = new Uint8Array(count);
    this.hiddenCount = 0;
    this.loaded = 0;
    this.scale = 1;
    this.dirty = new DirtyRows(Math.ceil(count / width));
    /** @type {{conditions: Condition[], scalars: Map<string, {values: Float32Array}>, space: Space} | null} */
    this.rule = null;
  }

  /** Take in a part of the particles. @param {number} start @param {Float32Array} positions (K, 3) @param {Float32Array} radii (K,) */
  put(start, positions, radii) {
    const { spheres } = this;
    for (let k = 0, at = 4 * start; k < radii.length; k++, at += 4) {
      spheres[at] = positions[3 * k];
      spheres[at + 1] = positions[3 * k + 1];
      spheres[at + 2] = positions[3 * k + 2];
      spheres[at + 3] = radii[k];
    }
    this.loaded = Math.max(this.loaded, start + radii.length);
    this.drawn.set(spheres.subarray(4 * start, 4 * (start + radii.length)), 4 * start);
    this.update(start, start + radii.length, true);
  }

  /** Scale all radii. @param {number} scale @returns {boolean} whether that changes anything */
  setScale(scale) {
    if (scale === this.scale) return false;
    this.scale = scale;
    this.update(0, this.loaded, true);
    return true;
  }

  /**
   * Hide what any condition hides.
   * @param {Condition[]} conditions those whose scalar has not come yet hide nothing
   * @param {Map<string, {values: Float32Array}>} scalars @param {Space} space
   * @returns {boolean} whether that changes anything
   */
  hide(conditions, scalars, space) {
    this.rule = { conditions, scalars, space };
    return this.update(0, this.loaded, false);
  }

  /** @param {number} first @param {number} last @param {boolean} radii whether these changed too @returns {boolean} */
  update(first, last, radii) {
    const tests = this.tests();
    const { spheres, drawn, hidden, scale } = this;
    const factor = Math.fround(scale);
    let changed = false;
    for (let id = first; id < last; id++) {
      let gone = 0;
      for (const test of tests) {
        if (test(id)) {
          gone = 1;
          break;
        }
      }
      if (gone === hidden[id] && !radii) continue;
      this.hiddenCount += gone - hidden[id];
      hidden[id] = gone;
      drawn[4 * id + 3] = gone ? 0 : spheres[4 * id + 3] * factor;
      this.dirty.add(Math.floor(id / this.width));
      changed = true;
    }
    return changed;
  }

  /** @returns {((id: number) => boolean)[]} */
  tests() {
    if (this.rule === null) return [];
    const { spheres } = this;
    const { conditions, scalars, space: { center, unit, bounds } } = this.rule;
    const diagonal = Math.hypot(...bounds[0].map((low, k) => bounds[1][k] - low));
    return conditions.flatMap((condition) => {
      if (condition.kind === "cut") {
        const [x, y, z] = condition.normal;
        const limit = (condition.offset - (x * center[0] + y * center[1] + z * center[2])) / unit + TOLERANCE * diagonal;
        return (/** @type {number} */ id) => x * spheres[4 * id] + y * spheres[4 * id + 1] + z * spheres[4 * id + 2] > limit;
      }
      const values = scalars.get(condition.scalar)?.values;
      if (values === undefined) return [];
      const low = Math.fround(condition.low ?? -Infinity), high = Math.fround(condition.high ?? Infinity);
      return (/** @type {number} */ id) => !(values[id] >= low && values[id] <= high);
    });
  }

  /** Scalars that conditions name and that have not come. @returns {string[]} */
  get missing() {
    const { conditions, scalars } = this.rule ?? { conditions: [], scalars: new Map() };
    return conditions.flatMap((each) => (each.kind === "select" && !scalars.has(each.scalar) ? [each.scalar] : []));
  }

  /** Call `upload(start, part)` with rows that changed, particles from `start` on. @param {(start: number, part: Float32Array) => void} upload */
  flush(upload) {
    this.dirty.flush((first, rows) => {
      const start = first * this.width;
      if (start >= this.loaded) return;
      upload(start, this.drawn.subarray(4 * start, 4 * Math.min(this.loaded, start + rows * this.width)));
    });
  }
}
