// Messages to and from the server; the other half of app/protocol.py, which describes the format.

export const SUBPROTOCOL = "luxel.v5";

/** Kinds of messages, as numbered in app/protocol.py. */
export const KIND = {
  hello: 1, sighted: 2, confirm: 3, setLight: 4, setFrame: 5, scalarRequest: 6, colormapRequest: 7, report: 8, geometryRequest: 9,
  scene: 16, light: 17, geometry: 18, scalar: 19, colormap: 20, tiles: 21, status: 22, error: 23, coarse: 24,
  codec: 32, payload: 33,
  setView: 40, loadView: 41, inspect: 42, view: 50, particle: 51,
  compare: 60, beside: 61,
  drawBy: 70, stream: 71, stopStream: 72, confirmFrame: 73, pickAt: 74, takeScreenshot: 75, cancelScreenshot: 76, confirmParts: 77,
  frame: 80, picked: 81, screenshotState: 82, screenshotPart: 83,
};

/** @typedef {Float32Array | Int32Array | Uint16Array | Int16Array | Uint8Array | Int8Array} Values */
/** @typedef {{kind: number, head: any, arrays: Record<string, any>}} Message */

// Half floats stay bits: they go to the graphics processor as they are.
const TYPES = /** @type {const} */ ({
  u1: Uint8Array, i1: Int8Array, u2: Uint16Array, i2: Int16Array, i4: Int32Array, f2: Uint16Array, f4: Float32Array,
});

/**
 * Take a message from the server apart. Arrays are views of `buffer`: nothing is copied.
 * @param {ArrayBuffer} buffer
 * @returns {Message}
 */
export function decode(buffer) {
  const view = new DataView(buffer);
  const kind = view.getUint8(0);
  const length = view.getUint32(4, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  let offset = 8 + length;
  /** @type {Record<string, Values>} */
  const arrays = {};
  for (const [name, [code, shape]] of Object.entries(head.arrays)) {
    const count = /** @type {number[]} */ (shape).reduce((a, b) => a * b, 1);
    const Type = TYPES[/** @type {keyof typeof TYPES} */ (code)];
    arrays[name] = new Type(buffer, offset, count);
    offset += Math.ceil((count * Type.BYTES_PER_ELEMENT) / 4) * 4;
  }
  return { kind, head, arrays };
}

/** @param {Values} array */
const code = (array) => (array instanceof Float32Array ? "f4" : array instanceof Uint8Array ? "u1" : "i4");

/**
 * Build a message, with flat arrays.
 * @param {number} kind
 * @param {Record<string, unknown>} head
 * @param {Record<string, Int32Array | Float32Array | Uint8Array>} [arrays]
 * @returns {ArrayBuffer}
 */
export function encode(kind, head, arrays = {}) {
  const listed = Object.fromEntries(Object.entries(arrays).map(([name, a]) => [name, [code(a), [a.length]]]));
  const text = new TextEncoder().encode(JSON.stringify({ ...head, arrays: listed }));
  const padded = Math.ceil(text.length / 4) * 4;
  const size = Object.values(arrays).reduce((sum, a) => sum + 4 * Math.ceil(a.byteLength / 4), 0);
  const buffer = new ArrayBuffer(8 + padded + size);
  const bytes = new Uint8Array(buffer);
  bytes[0] = kind;
  new DataView(buffer).setUint32(4, padded, true);
  bytes.fill(32, 8, 8 + padded);
  bytes.set(text, 8);
  let offset = 8 + padded;
  for (const array of Object.values(arrays)) {
    bytes.set(new Uint8Array(array.buffer, array.byteOffset, array.byteLength), offset);
    offset += 4 * Math.ceil(array.byteLength / 4);
  }
  return buffer;
}
