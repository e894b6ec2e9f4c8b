// Columns of whole numbers to positions, radii and scalars; the other half of app/packing.py, which describes them.

/**
 * @typedef {object} PackedScalar
 * @property {string} name
 * @property {number} low
 * @property {number} step
 * @property {boolean} [log]
 * @property {number} [missing] the code of what has no value
 * @property {[number, number]} range
 * @property {[number, number]} log_range
 * @property {boolean} whole
 */

/**
 * @typedef {object} Packing
 * @property {number} count
 * @property {{low: number[], step: number, bits: number}} positions
 * @property {{column: boolean, low?: number, step?: number, list?: number[]}} radii
 * @property {PackedScalar[]} scalars
 * @property {boolean} ids
 * @property {number[]} columns bytes of each
 */

/** Bytes of all columns of a particle. @param {Packing} packing */
export const rowBytes = ({ columns }) => columns.reduce((sum, bytes) => sum + bytes, 0);

/**
 * Take the columns of `count` particles apart.
 * @param {Packing} packing @param {Uint8Array} data @param {number} count
 */
export function unpack(packing, data, count) {
  let offset = 0;
  const columns = packing.columns.map((bytes) => {
    const column = differences(data, offset, count, bytes);
    offset += bytes * count;
    return column;
  });
  const { low, step, bits } = packing.positions;
  const mask = 2 ** bits - 1;
  const positions = new Float32Array(3 * count);
  for (let axis = 0; axis < 3; axis++) {
    const column = columns[axis];
    for (let k = 0; k < count; k++) positions[3 * k + axis] = low[axis] + step * (column[k] & mask);
  }
  let next = 3;
  const { radii: about } = packing;
  const codes = about.column ? columns[next++] : spares(columns, bits, 8 * packing.columns[0] - bits);
  const radii = Float32Array.from(codes, (code) => about.list?.[code] ?? (about.low ?? 0) * Math.exp(code * (about.step ?? 0)));
  const scalars = packing.scalars.map((scalar) => values(scalar, columns[next++]));
  return { positions, radii, scalars, ids: packing.ids ? columns[next] : null };
}

/** Sums of differences, which lie low bytes first. @param {Uint8Array} data @param {number} offset @param {number} count @param {number} bytes */
function differences(data, offset, count, bytes) {
  const found = new Uint32Array(count);
  for (let b = 0; b < bytes; b++) {
    for (let k = 0; k < count; k++) found[k] |= data[offset + b * count + k] << (8 * b);
  }
  const most = bytes === 4 ? -1 : 2 ** (8 * bytes) - 1;
  let sum = 0;
  for (let k = 0; k < count; k++) {
    sum = (sum + found[k]) & most;
    found[k] = sum;
  }
  return found;
}

/** The bits of three columns that positions leave free. @param {Uint32Array[]} columns @param {number} bits @param {number} spare */
function spares(columns, bits, spare) {
  const [x, y, z] = columns;
  const found = new Uint32Array(x.length);
  if (spare > 0) for (let k = 0; k < found.length; k++) found[k] = (x[k] >>> bits) | ((y[k] >>> bits) << spare) | ((z[k] >>> bits) << (2 * spare));
  return found;
}

/** @param {PackedScalar} scalar @param {Uint32Array} codes */
function values({ low, step, log, missing }, codes) {
  return Float32Array.from(codes, (code) => {
    if (code === missing) return NaN;
    if (log) return code === 0 ? 0 : low * Math.exp((code - 1) * step);
    return low + step * code;
  });
}
