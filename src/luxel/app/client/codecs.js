// Baked textures as they are stored, and how they lie on the graphics processor. Nothing here needs a server:
//
//     const baked = new BakedStore(description, arrays);  // what luxel.textures.codecs gives: describe() and shared
//     baked.put(start, bytes);                            // records from particle `start` on, as they come
//     set.setBaked(baked);                                // of a LightSet, `renderer.sets[0]`: from then on it shows them
//
// `description` is the codec's own, and how the records come: {kind, texels, ..., mapping, particles, payload_bytes,
// part}.
// Particle k has record k. `part` is how many records `put` takes at a time, a multiple of 2048; the last part is shorter.
// `arrays` are the codec's, flat, by name, and `decoding`: the luminance of each of the 256 codes.

import { Texture } from "./gl.js";
import { DirtyRows } from "./tiles.js";

/** @typedef {import("./gl.js").Program} Program */
/** @typedef {import("./lookup.js").Reader} Reader */
/** @typedef {Record<string, any>} Arrays */

export const ENTRIES = 2048; // in a row, and rows in a layer

/** Baked textures in memory; may come by parts, in any order. */
export class BakedStore {
  /**
   * @param {{kind: string, texels: number, mapping: string, particles: number, payload_bytes: number, part: number,
   *   components?: number, shift?: number, clusters?: number}} description
   * @param {Arrays} arrays
   */
  constructor(description, arrays) {
    this.description = description;
    this.arrays = arrays;
    this.count = description.particles;
    this.part = description.part;
    this.bytes = new Uint8Array(this.count * description.payload_bytes);
    this.parts = new Uint8Array(Math.max(1, Math.ceil(this.count / this.part)));
    this.dirty = new DirtyRows(this.parts.length);
    this.missing = this.parts.length;
    this.reader = reader(description);
    // For those who ask what a particle's light is: here there is one light, and nothing is ever evicted.
    this.current = 0;
    this.capacity = this.count;
    this.evicted = this.dropped = 0;
  }

  /** Whether all records are there. */
  get complete() {
    return this.missing === 0;
  }

  /** @param {number} start particle, a multiple of `part` @param {Uint8Array} bytes records of one part */
  put(start, bytes) {
    const k = start / this.part, size = this.description.payload_bytes;
    const expected = Math.min(this.part, this.count - start) * size;
    if (!Number.isInteger(k) || bytes.length !== expected) {
      throw new RangeError(`records of ${bytes.length} bytes at particle ${start}: a part has ${expected}`);
    }
    this.bytes.set(bytes, start * size);
    if (!this.parts[k]) this.missing--;
    this.parts[k] = 255;
    this.dirty.add(k);
  }

  /** @param {number} id */
  isCurrent(id) {
    return this.parts[Math.floor(id / this.part)] !== 0;
  }

  /** Nothing better comes. @param {number} _id */
  isEstimate(_id) {
    return false;
  }

  /** There is one light only. @param {number} _id */
  isStale(_id) {
    return false;
  }
}

/** @param {BakedStore["description"]} description @returns {Reader} */
function reader({ kind, texels, mapping, payload_bytes: size, shift = 0, clusters = 1 }) {
  const form = /** @type {const} */ ({ raw: "raw", vq: "vq", pca: "linear", sh: "linear", cpca: "clustered" })[kind];
  if (form === undefined) throw new RangeError(`this page cannot show textures stored as ${kind}`);
  return {
    form, texels, mapping, words: Math.ceil(size / 4), lead: clusters > 1 ? 1 : 0,
    unit: 2 ** -(form === "clustered" ? fractionBits(texels) : shift),
  };
}

/** Binary digits after the point of clustered PCA; the same as luxel.textures.codecs.linear.fraction_bits. @param {number} texels */
const fractionBits = (texels) => 23 - Math.ceil(Math.log2(255 * texels));

/** A store's textures on the graphics processor. */
export class BakedTextures {
  /** @param {WebGL2RenderingContext} gl @param {BakedStore} store */
  constructor(gl, store) {
    this.gl = gl;
    this.store = store;
    const { form, texels, words } = store.reader;
    const { arrays, description, count } = store;
    this.raw = form === "raw";
    this.payload = layers(gl, this.raw ? "r8ui" : "r32ui", count * (this.raw ? texels * texels : words));
    this.parts = new Texture(gl, "r8ui", 1, store.parts.length);
    this.decoding = new Texture(gl, "r32f", 256, 1);
    this.decoding.rows(arrays.decoding, 0, 1);
    /** @type {Record<string, Texture>} by the names of the shader's samplers */
    this.textures = { [this.raw ? "uAtlas" : "uRecords"]: this.payload };
    if (form === "vq") this.textures.uAtlas = filled(gl, "r8ui", arrays.codebook);
    if (form === "linear") Object.assign(this.textures, linear(gl, texels * texels, description, arrays));
    if (form === "clustered") Object.assign(this.textures, clustered(gl, texels * texels, store.reader, arrays));
    store.dirty.all();
    for (let k = 0; k < store.parts.length; k++) if (!store.parts[k]) store.dirty.remove(k);
    this.parts.rows(store.parts, 0, store.parts.length);
  }

  /** Upload what came since the last time. */
  upload() {
    const { store } = this;
    store.dirty.flush((first, count) => {
      for (let k = first; k < first + count; k++) this.uploadPart(k);
      this.parts.rows(store.parts.subarray(first, first + count), first, count);
    });
  }

  /** @param {number} k */
  uploadPart(k) {
    const { store, raw } = this;
    const size = store.description.payload_bytes, { words, texels } = store.reader;
    const start = k * store.part, end = Math.min(start + store.part, store.count);
    const bytes = store.bytes.subarray(start * size, end * size);
    const each = raw ? texels * texels : words;
    const first = (start * each) / ENTRIES;
    if (raw) return fill(this.payload, bytes, first);
    let records = bytes;
    if (4 * words !== size) { // records begin at whole words
      records = new Uint8Array(4 * words * (end - start));
      for (let r = 0; r < end - start; r++) {
        for (let b = 0; b < size; b++) records[4 * words * r + b] = bytes[size * r + b];
      }
    }
    if (records.byteOffset % 4) records = records.slice();
    fill(this.payload, new Uint32Array(records.buffer, records.byteOffset, records.length / 4), first);
  }

  /** @param {Program} program */
  bind(program) {
    program.texture("uDecoding", this.decoding).texture("uParts", this.parts).int("uPart", this.store.part);
    for (const [name, texture] of Object.entries(this.textures)) program.texture(name, texture);
  }

  delete() {
    for (const texture of [this.parts, this.decoding, ...Object.values(this.textures)]) texture.delete();
  }
}

/** @param {WebGL2RenderingContext} gl @param {number} size @param {any} description @param {Arrays} arrays */
function linear(gl, size, { components, shift }, { basis, offset }) {
  const groups = Math.ceil(components / 4);
  const rows = new Int16Array(4 * size * groups);
  for (let t = 0; t < size; t++) {
    for (let k = 0; k < components; k++) rows[4 * (size * (k >> 2) + t) + (k & 3)] = basis[components * t + k];
  }
  const half = shift ? 2 ** (shift - 1) : 0;
  return { uVectors: filled(gl, "rgba16i", rows), uOffsets: filled(gl, "r32f", Float32Array.from(offset, (x) => x + half)) };
}

/** @param {WebGL2RenderingContext} gl @param {number} size @param {Reader} reader @param {Arrays} arrays */
function clustered(gl, size, { unit }, { center, count, basis, scale, width, levels }) {
  const digits = 1 / unit;
  const offsets = Float32Array.from(center, (x) => roundEven((x / 64 + 0.5) * digits));
  let groups = 0;
  const clusters = Uint32Array.from(count, (n) => {
    const first = groups;
    groups += Math.ceil(n / 4);
    return (first | (Math.ceil(n / 4) << 24)) >>> 0;
  });
  const rows = new Int8Array(4 * size * groups), steps = new Uint32Array(4 * groups);
  /** @type {number[]} values of all coefficients; the first is for those that are there to fill a group */
  const values = [0];
  let s = 0;
  count.forEach((/** @type {number} */ n, /** @type {number} */ k) => {
    const first = clusters[k] & 0xffffff;
    for (let i = 0; i < n; i++, s++) {
      const at = 4 * first + i, bits = width[s];
      steps[at] = (values.length | (bits << 24)) >>> 0;
      for (let symbol = 0; symbol < 1 << bits; symbol++) {
        values.push(roundEven(Math.fround(scale[s] * levels[(1 << bits) - 2 + symbol])));
      }
      for (let t = 0; t < size; t++) rows[4 * (size * (at >> 2) + t) + (at & 3)] = basis[size * s + t];
    }
  });
  return {
    uOffsets: filled(gl, "r32f", offsets), uClusters: filled(gl, "r32ui", clusters), uSteps: filled(gl, "r32ui", steps),
    uLevels: filled(gl, "r32f", Float32Array.from(values)), uVectors: filled(gl, "rgba8i", rows),
  };
}

/** To the nearest whole number, and to the even one of two. @param {number} x */
function roundEven(x) {
  const low = Math.floor(x), rest = x - low;
  if (rest !== 0.5) return Math.round(x);
  return low % 2 === 0 ? low : low + 1;
}

/** A texture for a long array. @param {WebGL2RenderingContext} gl @param {import("./gl.js").Format} format @param {number} entries */
function layers(gl, format, entries) {
  const rows = Math.max(1, Math.ceil(entries / ENTRIES));
  return new Texture(gl, format, ENTRIES, Math.min(rows, ENTRIES), { layers: Math.ceil(rows / ENTRIES) });
}

/** Write an array from a row on, over the ends of layers; the rest of its last row becomes 0. @param {Texture} texture @param {any} data @param {number} row */
function fill(texture, data, row) {
  const width = ENTRIES * texture.channels;
  for (let from = 0; from < data.length;) {
    const most = Math.min(ENTRIES - (row % ENTRIES), Math.ceil((data.length - from) / width));
    const whole = Math.min(most, Math.floor((data.length - from) / width));
    const rows = whole || 1;
    let part = data.subarray(from, from + rows * width);
    if (!whole) {
      part = new data.constructor(width);
      part.set(data.subarray(from));
    }
    texture.rows(part, row % ENTRIES, rows, Math.floor(row / ENTRIES));
    from += rows * width;
    row += rows;
  }
}

/** @param {WebGL2RenderingContext} gl @param {import("./gl.js").Format} format @param {any} data */
function filled(gl, format, data) {
  const channels = format.startsWith("rgba") ? 4 : 1;
  const texture = layers(gl, format, data.length / channels);
  fill(texture, data, 0);
  return texture;
}
