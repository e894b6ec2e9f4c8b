// Which tile lies where in the atlas: slots, lights, eviction. Knows nothing of WebGL.

const ROW_BYTES = 2048;
const GENERATIONS = 64;
const SLOT_BITS = 24;
export const LAYER_ROWS = 2048;
export const ATLAS_BYTES = 64 << 20; // of a store, by default

/** Rows of a texture that wait for upload. */
export class DirtyRows {
  /** @param {number} count */
  constructor(count) {
    this.flags = new Uint8Array(count);
    this.low = count;
    this.high = -1;
  }

  /** @param {number} row */
  add(row) {
    this.flags[row] = 1;
    if (row < this.low) this.low = row;
    if (row > this.high) this.high = row;
  }

  /** @param {number} row */
  remove(row) {
    this.flags[row] = 0;
  }

  all() {
    this.flags.fill(1);
    this.low = 0;
    this.high = this.flags.length - 1;
  }

  /** Call `upload(first, count)` for each run of dirty rows, which are clean then. @param {(first: number, count: number) => void} upload */
  flush(upload) {
    for (let row = this.low; row <= this.high; row++) {
      if (!this.flags[row]) continue;
      const first = row;
      while (row <= this.high && this.flags[row]) this.flags[row++] = 0;
      upload(first, row - first);
    }
    this.low = this.flags.length;
    this.high = -1;
  }
}

export class TileStore {
  /**
   * @param {number} particles @param {number} texels rows and columns of a tile
   * @param {number} budget bytes @param {number} width particles in a row of the slot texture
   */
  constructor(particles, texels, budget, width) {
    this.tileBytes = texels * texels;
    const wanted = Math.min(particles, Math.floor(budget / this.tileBytes), (1 << SLOT_BITS) - 1);
    this.rows = Math.max(1, Math.ceil((wanted * this.tileBytes) / ROW_BYTES));
    this.capacity = wanted;
    this.bytes = new Uint8Array(this.rows * ROW_BYTES);
    this.dirtyAtlas = new DirtyRows(this.rows);
    this.width = width;
    this.slots = new Int32Array(Math.ceil(particles / width) * width).fill(-1);
    this.dirtySlots = new DirtyRows(this.slots.length / width);
    this.owner = new Int32Array(wanted).fill(-1);
    /** By slot: whether a better tile may come. */
    this.estimates = new Uint8Array(wanted);
    this.used = 0;
    this.hand = 0;
    this.evicted = 0;
    this.dropped = 0;
    /** @type {Map<string, number>} */
    this.generations = new Map();
    this.lightCount = 0;
    this.current = -1;
    this.decoding = new Float32Array(GENERATIONS * 256);
    this.dirtyDecoding = true;
  }

  /** Take on a light: its tiles are the current ones from now on. @param {string} key @param {Float32Array} decoding */
  setLight(key, decoding) {
    let generation = this.generations.get(key);
    if (generation === undefined) {
      generation = this.lightCount++ % GENERATIONS;
      for (const [old, each] of this.generations) {
        if (each === generation) this.forget(old, each);
      }
      this.generations.set(key, generation);
      this.decoding.set(decoding, generation * 256);
      this.dirtyDecoding = true;
    }
    this.current = generation;
  }

  /** @param {number} id */
  isCurrent(id) {
    return this.slots[id] >> SLOT_BITS === this.current;
  }

  /** Whether a better tile than the one it has may come. @param {number} id */
  isEstimate(id) {
    return this.slots[id] >= 0 && this.estimates[this.slots[id] & ((1 << SLOT_BITS) - 1)] !== 0;
  }

  /** Whether it has a tile, but of another light. @param {number} id */
  isStale(id) {
    return this.slots[id] >= 0 && !this.isCurrent(id);
  }

  /**
   * Store tiles. A tile of another light is replaced in place; when all is full, one that was not seen lately goes.
   * @param {string} key @param {Int32Array} ids @param {Uint8Array} codes
   * @param {(id: number) => boolean} visible those are never evicted
   * @param {Uint8Array | null} [estimates] which of them are to be asked for again
   * @returns {number} how many were stored
   */
  put(key, ids, codes, visible, estimates = null) {
    const generation = this.generations.get(key);
    if (generation === undefined) return 0;
    let stored = 0;
    for (let k = 0; k < ids.length; k++) {
      const id = ids[k];
      const slot = this.slots[id] >= 0 ? this.slots[id] & ((1 << SLOT_BITS) - 1) : this.free(visible);
      if (slot < 0) {
        this.dropped++;
        continue;
      }
      this.owner[slot] = id;
      this.estimates[slot] = estimates === null ? 0 : estimates[k];
      this.setSlot(id, slot | (generation << SLOT_BITS));
      const at = slot * this.tileBytes;
      this.bytes.set(codes.subarray(k * this.tileBytes, (k + 1) * this.tileBytes), at);
      const last = Math.floor((at + this.tileBytes - 1) / ROW_BYTES);
      for (let row = Math.floor(at / ROW_BYTES); row <= last; row++) this.dirtyAtlas.add(row);
      stored++;
    }
    return stored;
  }

  /** @param {(id: number) => boolean} visible @returns {number} a slot, or -1 */
  free(visible) {
    if (this.used < this.capacity) return this.used++;
    for (let tries = 0; tries < this.capacity; tries++) {
      const slot = this.hand;
      this.hand = (this.hand + 1) % this.capacity;
      const owner = this.owner[slot];
      if (owner >= 0 && visible(owner)) continue;
      if (owner >= 0) {
        this.setSlot(owner, -1);
        this.evicted++;
      }
      return slot;
    }
    return -1;
  }

  /** @param {number} id @param {number} value */
  setSlot(id, value) {
    this.slots[id] = value;
    this.dirtySlots.add(Math.floor(id / this.width));
  }

  /** @param {string} key @param {number} generation */
  forget(key, generation) {
    this.generations.delete(key);
    for (let slot = 0; slot < this.used; slot++) {
      const owner = this.owner[slot];
      if (owner >= 0 && this.slots[owner] >> SLOT_BITS === generation) {
        this.setSlot(owner, -1);
        this.owner[slot] = -1;
      }
    }
  }

  /** Everything has to be uploaded again. */
  touchAll() {
    this.dirtyAtlas.all();
    this.dirtySlots.all();
    this.dirtyDecoding = true;
  }
}
