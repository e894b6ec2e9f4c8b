// What lights the particles in one picture, or in one part of it: analytic lights, and textures from a tile store, a
// store of baked textures, or none. The renderer shades each of its sets with a program made for what the set holds.

import { BakedTextures } from "./codecs.js";
import { Texture } from "./gl.js";
import { LAYER_ROWS } from "./tiles.js";

/** @typedef {import("./codecs.js").BakedStore} BakedStore */
/** @typedef {import("./coarse.js").CoarseStore} CoarseStore */
/** @typedef {import("./gl.js").Program} Program */
/** @typedef {import("./lookup.js").Reader} Reader */
/** @typedef {import("./tiles.js").TileStore} TileStore */

export const LIGHTS_MAX = 8; // of a kind

export class LightSet {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    /** Flat arrays as in the light message. @type {{sky: ArrayLike<number>, suns: Float32Array, globes: Float32Array, quads: Float32Array}} */
    this.lights = { sky: [1, 1, 0, 0, 1], suns: new Float32Array(0), globes: new Float32Array(0), quads: new Float32Array(0) };
    /** Luminance that the tone curve displays as white. */
    this.white = 1;
    /** Whether textures are shown at all; the Lambertian model has none. */
    this.textured = false;
    /** Luminance of 1 in coarse records. */
    this.coarseScale = 1;
    this.texels = 16;
    this.mapping = "latlong";
    /** @type {TileStore | null} */
    this.tiles = null;
    /** @type {CoarseStore | null} */
    this.records = null;
    /** @type {BakedTextures | null} */
    this.baked = null;
    /** @type {{slots: Texture, atlas: Texture, decoding: Texture} | null} */
    this.store = null;
    /** @type {Texture | null} */
    this.coarse = null;
  }

  /** Show tiles as they come, and coarse records before that. @param {TileStore} tiles @param {CoarseStore} records @param {{texels: number, mapping: string}} scene */
  setTiles(tiles, records, { texels, mapping }) {
    const { gl } = this;
    this.delete();
    this.tiles = tiles;
    this.records = records;
    this.texels = texels;
    this.mapping = mapping;
    this.store = {
      slots: new Texture(gl, "r32i", tiles.width, Math.max(1, tiles.slots.length / tiles.width)),
      atlas: new Texture(gl, "r8ui", 2048, Math.min(tiles.rows, LAYER_ROWS), { layers: Math.ceil(tiles.rows / LAYER_ROWS) }),
      decoding: new Texture(gl, "r32f", 256, 64),
    };
    tiles.touchAll();
    records.dirty.all();
  }

  /** Show baked textures in place of tiles. @param {BakedStore | null} store null goes back to tiles */
  setBaked(store) {
    this.baked?.delete();
    this.baked = store && new BakedTextures(this.gl, store);
  }

  /** Upload what changed in the stores. */
  upload() {
    if (this.baked) return this.baked.upload();
    if (this.tiles && this.store) uploadTiles(this.tiles, this.store);
    if (this.records?.used) this.uploadCoarse(this.records);
  }

  /** @param {CoarseStore} records */
  uploadCoarse(records) {
    if (this.coarse === null) {
      this.coarse = new Texture(this.gl, "rgba16f", records.width, records.rows);
      records.dirty.all();
    }
    const { coarse } = this;
    records.dirty.flush((first, count) => {
      coarse.rows(records.data.subarray(4 * first * records.width, 4 * (first + count) * records.width), first, count);
    });
  }

  /**
   * What a shader for this set has to know.
   * @returns {{reader: Reader | null, baked: boolean, complete: boolean, coarse: boolean, suns: number, globes: number, quads: number}}
   */
  traits() {
    const { suns, globes, quads } = this.lights;
    const textured = this.textured && (this.baked !== null || this.store !== null);
    /** @type {Reader} */
    const tile = { form: "raw", texels: this.texels, mapping: this.mapping, words: 0, unit: 1, lead: 0 };
    return {
      reader: textured ? this.baked?.store.reader ?? tile : null,
      baked: this.baked !== null,
      complete: textured && this.baked !== null && this.baked.store.complete,
      coarse: textured && this.baked === null && this.coarse !== null,
      suns: Math.min(suns.length / 6, LIGHTS_MAX), globes: Math.min(globes.length / 5, LIGHTS_MAX), quads: Math.min(quads.length / 14, LIGHTS_MAX),
    };
  }

  /** Hand everything to a program made for `traits()`. @param {Program} program */
  bind(program) {
    const { baked, store, coarse } = this;
    if (baked) baked.bind(program);
    else if (store) program.texture("uSlots", store.slots).texture("uAtlas", store.atlas).texture("uDecoding", store.decoding);
    if (coarse) program.texture("uCoarse", coarse).float("uCoarseScale", this.coarseScale).int("uCurrent", this.tiles?.current ?? 0);
    const { sky, suns, globes, quads } = this.lights;
    program.float("uSky", [sky[0], sky[1]]).float("uSkyAxis", [sky[2], sky[3], sky[4]])
      .vec4s("uSuns", packed(suns, 6, (l) => l.slice(0, 5)))
      .vec4s("uGlobes", packed(globes, 5, (l) => l))
      .vec4s("uQuads", packed(quads, 14, (l) => [...[0, 1, 2].map((a) => l[a] + 0.5 * (l[3 + a] + l[6 + a])), l[13], ...l.slice(9, 13)]));
  }

  /** Free the graphics memory. */
  delete() {
    this.baked?.delete();
    this.coarse?.delete();
    for (const texture of Object.values(this.store ?? {})) texture.delete();
    this.baked = this.coarse = this.store = null;
  }
}

/** Lights as pairs of vectors. @param {Float32Array} values @param {number} each numbers of a light @param {(light: number[]) => number[]} pack */
function packed(values, each, pack) {
  const count = Math.min(values.length / each, LIGHTS_MAX);
  const found = new Float32Array(8 * count);
  for (let k = 0; k < count; k++) found.set(pack([...values.subarray(each * k, each * (k + 1))]), 8 * k);
  return found;
}

/** @param {TileStore} tiles @param {{slots: Texture, atlas: Texture, decoding: Texture}} store */
function uploadTiles(tiles, { slots, atlas, decoding }) {
  tiles.dirtyAtlas.flush((first, count) => {
    for (let row = first; row < first + count;) {
      const layer = Math.floor(row / LAYER_ROWS);
      const rows = Math.min(first + count, (layer + 1) * LAYER_ROWS) - row;
      atlas.rows(tiles.bytes.subarray(row * 2048, (row + rows) * 2048), row % LAYER_ROWS, rows, layer);
      row += rows;
    }
  });
  tiles.dirtySlots.flush((first, count) => {
    slots.rows(tiles.slots.subarray(first * tiles.width, (first + count) * tiles.width), first, count);
  });
  if (tiles.dirtyDecoding) {
    decoding.rows(tiles.decoding, 0, 64);
    tiles.dirtyDecoding = false;
  }
}
