// First light: a coarse record for each particle, shown until its tile is there. Knows nothing of WebGL.

import { DirtyRows } from "./tiles.js";

const NONE = 0xbc00; // -1 as a half float: no record

export class CoarseStore {
  /** @param {number} particles @param {number} width particles in a row of the texture */
  constructor(particles, width) {
    this.width = width;
    this.rows = Math.max(1, Math.ceil(particles / width));
    this.key = "";
    /** Half floats, four a particle; nothing until the first record comes. */
    this.data = new Uint16Array(0);
    this.dirty = new DirtyRows(this.rows);
    this.received = 0;
  }

  /** Whether there is any record. */
  get used() {
    return this.data.length > 0;
  }

  /** Take on a light: records of any other are void. @param {string} key */
  setLight(key) {
    if (key === this.key) return;
    this.key = key;
    this.data.fill(NONE);
    this.dirty.all();
  }

  /** @param {string} key @param {Int32Array} ids @param {Uint16Array} records (K, 4) @returns {boolean} whether they are of use */
  put(key, ids, records) {
    if (key !== this.key) return false;
    if (!this.used) this.data = new Uint16Array(4 * this.rows * this.width).fill(NONE);
    for (let k = 0; k < ids.length; k++) {
      this.data.set(records.subarray(4 * k, 4 * k + 4), 4 * ids[k]);
      this.dirty.add(Math.floor(ids[k] / this.width));
    }
    this.received += ids.length;
    return true;
  }

  /** @param {number} id */
  has(id) {
    return this.used && this.data[4 * id] !== NONE;
  }
}
