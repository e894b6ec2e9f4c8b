// Runs the page's renderer on a WebGL that only writes down what it is asked for: `node record.js FOLDER`.
//
// FOLDER/input.json and input.bin come from prepare.py; calls.json and blobs.bin are what play.py plays on a real
// graphics processor. So shaders, formats, layouts and draw calls there are those of the page, whatever these become.

import { createHash } from "node:crypto";
import { readFileSync, writeFileSync } from "node:fs";

import { BakedStore } from "../../src/luxel/app/client/codecs.js";
import { CoarseStore } from "../../src/luxel/app/client/coarse.js";
import { ALL, PARTICLES_WIDTH, Renderer } from "../../src/luxel/app/client/renderer.js";
import { ATLAS_BYTES, TileStore } from "../../src/luxel/app/client/tiles.js";

// As the specification of WebGL2 has them, and OpenGL ES 3.
const CONSTANTS = {
  POINTS: 0, TRIANGLES: 4, ONE: 1, LESS: 0x0201, GREATER: 0x0204, DEPTH_TEST: 0x0b71, BLEND: 0x0be2, DITHER: 0x0bd0,
  SCISSOR_TEST: 0x0c11, UNPACK_ALIGNMENT: 0x0cf5, MAX_TEXTURE_SIZE: 0x0d33, TEXTURE_2D: 0x0de1, TEXTURE_2D_ARRAY: 0x8c1a,
  BYTE: 0x1400, UNSIGNED_BYTE: 0x1401, SHORT: 0x1402, INT: 0x1404, UNSIGNED_INT: 0x1405, FLOAT: 0x1406, HALF_FLOAT: 0x140b,
  COLOR: 0x1800, DEPTH: 0x1801, RED: 0x1903, RGBA: 0x1908, RENDERER: 0x1f01, NEAREST: 0x2600, LINEAR: 0x2601,
  TEXTURE_MAG_FILTER: 0x2800, TEXTURE_MIN_FILTER: 0x2801, TEXTURE_WRAP_S: 0x2802, TEXTURE_WRAP_T: 0x2803, CLAMP_TO_EDGE: 0x812f,
  RGBA8: 0x8058, TEXTURE0: 0x84c0, RGBA32F: 0x8814, RGBA16F: 0x881a, R16F: 0x822d, R32F: 0x822e, R8UI: 0x8232, R32I: 0x8235,
  R32UI: 0x8236, RGBA16I: 0x8d88, RGBA8I: 0x8d8e, RED_INTEGER: 0x8d94, RGBA_INTEGER: 0x8d99, ALIASED_POINT_SIZE_RANGE: 0x846d,
  ELEMENT_ARRAY_BUFFER: 0x8893, STREAM_READ: 0x88e1, STATIC_DRAW: 0x88e4, PIXEL_PACK_BUFFER: 0x88eb, FRAGMENT_SHADER: 0x8b30,
  VERTEX_SHADER: 0x8b31, COMPILE_STATUS: 0x8b81, LINK_STATUS: 0x8b82, IMPLEMENTATION_COLOR_READ_TYPE: 0x8b9a,
  IMPLEMENTATION_COLOR_READ_FORMAT: 0x8b9b, DEPTH_COMPONENT32F: 0x8cac, FRAMEBUFFER_COMPLETE: 0x8cd5, COLOR_ATTACHMENT0: 0x8ce0,
  DEPTH_ATTACHMENT: 0x8d00, FRAMEBUFFER: 0x8d40, RENDERBUFFER: 0x8d41, SYNC_GPU_COMMANDS_COMPLETE: 0x9117, SYNC_STATUS: 0x9114,
  SIGNALED: 0x9119,
};

class Recorder {
  /** @param {number} pointMax pixels that a point may measure here */
  constructor(pointMax) {
    this.calls = [];
    this.objects = 0;
    /** Buffers that are not written down, by name, because the player makes them. @type {Map<ArrayBufferLike, string>} */
    this.named = new Map();
    const answers = {
      getParameter: (what) => ({
        [CONSTANTS.MAX_TEXTURE_SIZE]: 16384, [CONSTANTS.ALIASED_POINT_SIZE_RANGE]: [1, pointMax], [CONSTANTS.RENDERER]: "recorder",
        [CONSTANTS.IMPLEMENTATION_COLOR_READ_FORMAT]: CONSTANTS.RGBA_INTEGER, // what every driver can do
        [CONSTANTS.IMPLEMENTATION_COLOR_READ_TYPE]: CONSTANTS.UNSIGNED_INT,
      })[what],
      getExtension: (name) => (name === "WEBGL_debug_renderer_info" ? null : {}),
      getShaderParameter: () => true,
      getProgramParameter: () => true,
      checkFramebufferStatus: () => CONSTANTS.FRAMEBUFFER_COMPLETE,
      getSyncParameter: () => CONSTANTS.SIGNALED,
      isContextLost: () => false,
    };
    this.gl = new Proxy({}, {
      get: (_, name) => {
        if (name in answers) return answers[name];
        if (name in CONSTANTS) return CONSTANTS[name];
        if (/^[A-Z]/.test(name)) throw new Error(`record.js does not know the constant ${name}`);
        return (...args) => this.call(name, args);
      },
    });
  }

  call(name, args) {
    const makes = /^create|^fenceSync$|^getUniformLocation$/.test(name);
    const made = makes ? { object: this.objects++ } : undefined;
    this.calls.push([name, args.map((value) => this.plain(value)), ...(makes ? [made.object] : [])]);
    return made;
  }

  plain(value) {
    if (ArrayBuffer.isView(value)) return { data: blob(value, this.named.get(value.buffer)) };
    return typeof value === "boolean" ? Number(value) : value;
  }

  /** The calls since the last time. */
  take() {
    return this.calls.splice(0);
  }
}

const blobs = [], known = new Map();
let blobBytes = 0;

/** Where bytes are: name, offset, length. @param {ArrayBufferView} view @param {string | undefined} name */
function blob(view, name) {
  if (name !== undefined) return [name, view.byteOffset, view.byteLength];
  const bytes = Buffer.from(view.buffer, view.byteOffset, view.byteLength);
  const hash = createHash("sha1").update(bytes).digest("hex");
  let at = known.get(hash);
  if (at === undefined) {
    at = blobBytes;
    blobs.push(Buffer.from(bytes));
    blobBytes += bytes.length;
    known.set(hash, at);
  }
  return ["blobs", at, bytes.length];
}

const folder = process.argv[2];
const input = JSON.parse(readFileSync(`${folder}/input.json`, "utf8"));
const file = readFileSync(`${folder}/input.bin`);
const TYPES = { float32: Float32Array, int32: Int32Array, uint8: Uint8Array, int8: Int8Array, int16: Int16Array, uint16: Uint16Array };
const array = ({ offset, length, type }) => {
  const bytes = file.subarray(offset, offset + length * TYPES[type].BYTES_PER_ELEMENT);
  return new TYPES[type](new Uint8Array(bytes).buffer);
};
const { count, width, height, cameras } = input;
const shape = { width, height, epoch: 0 };

/** Everything of one way to draw spheres. @param {number} pointMax */
function record(pointMax) {
  const recorder = new Recorder(pointMax);
  const { named } = recorder;
  const renderer = new Renderer({ width, height, getContext: () => recorder.gl });
  renderer.resize();
  renderer.setScene(count, input.reach);
  renderer.setSpheres(0, array(input.spheres));
  renderer.setValues(array(input.values));
  renderer.setLut(array(input.lut));
  Object.assign(renderer.look, { uniform: false, packed: false });
  const [set] = renderer.sets;
  const lights = Object.fromEntries(["sky", "suns", "globes", "quads"].map((name) => [name, array(input.lights[name])]));
  Object.assign(set, { lights, white: input.white, textured: false });
  const setup = recorder.take();

  const drawn = (camera, k) => {
    renderer.readback.poll();
    renderer.drawSample(camera, [0, 0], shape, 0, true, ALL);
    renderer.present(0, 1, shape, renderer.targets.capture); // in place of the canvas
    renderer.endFrame("");
    while (renderer.busy);
    renderer.sweep(shape, 4, k);
    return recorder.take();
  };
  const part = (name) => {
    set.upload();
    const first = [...recorder.take(), ...drawn(cameras[0], 0)]; // makes the programs too
    return { name, first, frames: cameras.map(drawn) };
  };

  const parts = [part("lambert")];
  set.textured = true;
  for (const { name, payload, arrays, ...description } of input.codecs) {
    const codec = Object.fromEntries(Object.entries(arrays).map(([key, each]) => [key, array(each)]));
    const store = new BakedStore({ ...description, particles: count, part: count }, codec);
    if (payload === null) named.set(store.bytes.buffer, name);
    store.put(0, payload === null ? new Uint8Array(store.bytes.length) : array(payload));
    set.setBaked(store);
    parts.push(part(name));
  }
  set.setBaked(null);
  const ids = array(input.visible);
  const tiles = new TileStore(count, input.texels, ATLAS_BYTES, PARTICLES_WIDTH), coarse = new CoarseStore(count, PARTICLES_WIDTH);
  named.set(tiles.bytes.buffer, "tiles");
  tiles.setLight("light", array(input.decoding));
  coarse.setLight("light");
  const some = ids.subarray(0, tiles.capacity);
  tiles.put("light", some, new Uint8Array(some.length * input.texels ** 2), () => true);
  coarse.put("light", ids, new Uint16Array(4 * ids.length));
  set.setTiles(tiles, coarse, { texels: input.texels, mapping: input.mapping });
  parts.push(part("tiles"));
  const { capture, ids: idTarget } = renderer.targets;
  const sizes = Object.fromEntries([...named].map(([buffer, name]) => [name, buffer.byteLength]));
  return { setup, parts, sizes, objects: recorder.objects, capture: capture.framebuffer.object, ids: idTarget.framebuffer.object };
}

const points = record(Infinity), quads = record(1);
writeFileSync(`${folder}/calls.json`, JSON.stringify({ points, quads }));
writeFileSync(`${folder}/blobs.bin`, Buffer.concat(blobs));
