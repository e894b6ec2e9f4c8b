// Scalars to positions in a colour map, and the colour bar; the same rules as luxel.scene.view.

/** @typedef {{values: Float32Array, range: [number, number], logRange: [number, number], whole: boolean, missing?: boolean, labels: string[] | null}} Scalar */

/** No colour map: a vector's components, which are scalars called name.x and so on, are the colours; as luxel.scene.colormap.RGB. */
export const RGB = "rgb";

/**
 * Colours in one number each, which float32 holds exactly: red · 65536 + green · 256 + blue.
 * @param {Scalar[]} channels each whole numbers 0..255 or others 0..1
 */
export function packed(channels) {
  const found = new Float32Array(channels[0].values.length);
  for (const { values, whole } of channels) {
    for (let k = 0; k < found.length; k++) found[k] = 256 * found[k] + (whole ? values[k] : Math.round(255 * values[k]));
  }
  return found;
}

/** sRGB to linear light, [0, 1]. @param {number} c */
export const toLinear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);

/** @param {string} hex "#rrggbb" @returns {number[]} sRGB in [0, 1] */
export const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

/** Top and bottom of the background in linear light: a little grading gives depth. @param {string} hex */
export function grading(hex) {
  const base = rgb(hex).map(toLinear);
  const light = Math.max(...base); // bright backgrounds need less of it
  return { base, top: base.map((c) => Math.min(1, c * (1.6 - 0.55 * light))), bottom: base.map((c) => c * (0.62 + 0.26 * light)) };
}

/** Whether a scalar is shown as codes rather than as a scale. @param {Scalar} scalar @param {number} rows of the colour map @param {[number, number] | null} range @param {boolean} log */
export const isCategorical = (scalar, rows, range, log) =>
  range === null && !log && (scalar.labels !== null || (rows < 256 && scalar.whole));

/**
 * @param {Scalar} scalar @param {number} rows @param {[number, number] | null} range @param {boolean} log
 * @returns {Float32Array} (N,) in [0, 1], or -1 for no data
 */
export function normalised(scalar, rows, range, log) {
  const { values } = scalar;
  const found = new Float32Array(values.length);
  if (isCategorical(scalar, rows, range, log)) {
    const n = rows === 256 ? Math.max(1, scalar.labels?.length ?? 1) : rows;
    for (let k = 0; k < found.length; k++) {
      const v = values[k];
      found[k] = Number.isFinite(v) ? (Math.floor(((v % n) + n) % n) + 0.5) / n : -1;
    }
    return found;
  }
  let [low, high] = range ?? (log ? scalar.logRange : scalar.range);
  if (log) [low, high] = [Math.log(low), Math.log(high)];
  const factor = 1 / (0.5 * high - 0.5 * low); // halves: the difference of two huge numbers would overflow
  for (let k = 0; k < found.length; k++) {
    const v = values[k];
    if (Number.isNaN(v)) {
      found[k] = -1;
      continue;
    }
    const x = log ? Math.log(Math.max(v, 0)) : v;
    found[k] = Math.min(1, Math.max(0, (0.5 * x - 0.5 * low) * factor));
  }
  return found;
}

/** Round values in [low, high], about `count` of them. @param {number} low @param {number} high @param {boolean} log @param {number} [count] @returns {number[]} */
export function ticks(low, high, log, count = 6) {
  /** @type {number[]} */
  const found = [];
  if (log) {
    const [first, last] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
    const step = Math.max(1, Math.ceil((last - first + 1) / (count + 2)));
    for (let e = first; e <= last; e += step) found.push(10 ** e);
    if (found.length >= 2) return found;
    return ticks(low, high, false, count).filter((v) => v > 0);
  }
  const span = high - low;
  const rough = span / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 2.5, 5, 10].find((m) => m * power >= rough * 0.999) ?? 10);
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * span; k++) found.push(k * step);
  return found;
}

/** @param {number} value @param {number} span what neighbouring labels must tell apart */
export function label(value, span) {
  if (value === 0 || Math.abs(value) < 1e-9 * span) return "0";
  const size = Math.max(Math.abs(value), span);
  if (size >= 1e5 || size < 1e-3) return value.toExponential(1).replace(".0e", "e").replace("e+", "e");
  const digits = Math.max(0, 2 - Math.floor(Math.log10(span)));
  return value.toFixed(Math.min(6, digits)).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "").replace("-", "−");
}

/**
 * Draw the colour bar into its canvas.
 * @param {HTMLCanvasElement} canvas
 * @param {{lut: Uint8Array, range: [number, number], log: boolean, title: string, labels: string[] | null, noData: string | null}} what
 */
export function drawColorbar(canvas, { lut, range, log, title, labels, noData }) {
  const ratio = window.devicePixelRatio || 1;
  const style = getComputedStyle(canvas);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const c = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  c.scale(ratio, ratio);
  c.font = `12px ${style.fontFamily}`;
  c.fillStyle = style.color;
  c.strokeStyle = style.color;
  c.textBaseline = "middle";
  c.textAlign = "right";
  c.fillText(title, width - 1, 8, width - 2);
  const [right, top] = [width - 1, 26];
  const bottom = height - (noData ? 30 : 8);
  const [left, rows] = [right - 14, lut.length / 3];
  const color = (/** @type {number} */ k) => `rgb(${lut[3 * k]} ${lut[3 * k + 1]} ${lut[3 * k + 2]})`;
  if (labels) {
    const shown = Math.min(labels.length, Math.floor((bottom - top) / 18));
    for (let k = 0; k < shown; k++) {
      const row = rows === 256 ? Math.min(255, Math.floor((k + 0.5) / labels.length * 256)) : k % rows;
      c.fillStyle = color(row);
      c.fillRect(left, top + 18 * k, 14, 14);
      c.fillStyle = style.color;
      c.fillText(labels[k], left - 7, top + 18 * k + 7, left - 8);
    }
  } else {
    for (let y = top; y < bottom; y++) {
      c.fillStyle = color(Math.min(rows - 1, Math.floor(((bottom - y - 0.5) / (bottom - top)) * rows)));
      c.fillRect(left, y, 14, 1.5);
    }
    const [low, high] = range;
    const scale = log ? Math.log : (/** @type {number} */ x) => x;
    c.fillStyle = style.color;
    for (const value of ticks(low, high, log)) {
      const y = bottom - ((scale(value) - scale(low)) / (scale(high) - scale(low))) * (bottom - top);
      c.fillRect(left - 4, Math.round(y) - 0.5, 4, 1);
      c.fillText(label(value, log ? Math.abs(value) : high - low), left - 8, Math.min(bottom - 2, Math.max(top + 3, y)), left - 9);
    }
  }
  if (noData) {
    c.fillStyle = noData;
    c.fillRect(left, height - 16, 14, 12);
    c.fillStyle = style.color;
    c.fillText("no data", left - 8, height - 10);
  }
}
