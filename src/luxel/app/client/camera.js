// Cameras in normalised units: the same mathematics as luxel.scene.camera.

/** @typedef {[number, number, number]} Vec */
/** @typedef {{eye: Vec, target: Vec, up: Vec, fov: number, height: number | null}} Camera */
/** @typedef {{right: Vec, up: Vec, forward: Vec}} Basis */

const ELEVATION_MAX = (89.99 * Math.PI) / 180;
const MARGIN = 1.06;

/** @param {Vec} a @param {Vec} b @returns {Vec} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @param {Vec} a @param {Vec} b @returns {Vec} */
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @param {Vec} a @param {number} s @returns {Vec} */
export const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
/** @param {Vec} a @param {Vec} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vec} a @param {Vec} b @returns {Vec} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {Vec} a */
export const length = (a) => Math.hypot(a[0], a[1], a[2]);
/** @param {Vec} a @returns {Vec} */
export const unit = (a) => scale(a, 1 / length(a));

/** @param {Camera} camera @returns {Basis} */
export function basis(camera) {
  const forward = unit(sub(camera.target, camera.eye));
  const up = unit(camera.up);
  let right = cross(forward, up);
  if (length(right) < 1e-6) right = cross(forward, leastAxis(up));
  right = unit(right);
  return { right, up: cross(right, forward), forward };
}

/** The axis that `v` points along least. @param {Vec} v @returns {Vec} */
function leastAxis(v) {
  const sizes = v.map(Math.abs), k = sizes.indexOf(Math.min(...sizes));
  return [k === 0 ? 1 : 0, k === 1 ? 1 : 0, k === 2 ? 1 : 0];
}

/** Half the height of the picture: at distance 1 for perspective, anywhere for orthographic. @param {Camera} camera */
export const halfHeight = (camera) =>
  camera.height === null ? Math.tan((camera.fov * Math.PI) / 360) : camera.height / 2;

/** Rows: what +X, +Y and +Z of a Z-up world become when `up` points up. @param {string} up @returns {Vec[]} */
export function upFrame(up) {
  const k = "xyz".indexOf(up) + 1;
  /** @type {Vec[]} */
  const rows = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  return rows.map((_, i) => rows[(i + k) % 3]);
}

/** @param {Vec[]} frame @param {number} azimuth radians @param {number} elevation radians @returns {Vec} */
export function direction(frame, azimuth, elevation) {
  const [a, b, c] = [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)];
  return add(add(scale(frame[0], a), scale(frame[1], b)), scale(frame[2], c));
}

/**
 * A camera that sees all of `bounds` from the direction `towards`.
 * @param {[Vec, Vec]} bounds
 * @param {Vec} towards unit vector from the target to the eye
 * @param {{up: Vec, fov: number, aspect: number, orthographic: boolean}} options
 * @returns {Camera}
 */
export function framing(bounds, towards, { up, fov, aspect, orthographic }) {
  const [low, high] = bounds;
  const target = scale(add(low, high), 0.5);
  const size = length(sub(high, low)) || 1;
  /** @type {Camera} */
  const probe = { eye: add(target, scale(towards, size)), target, up, fov, height: null };
  const { right, up: upward, forward } = basis(probe);
  const slope = Math.tan((fov * Math.PI) / 360) / MARGIN;
  let distance = 0;
  let half = 0;
  for (let k = 0; k < 8; k++) {
    /** @type {Vec} */
    const corner = [k & 1 ? high[0] : low[0], k & 2 ? high[1] : low[1], k & 4 ? high[2] : low[2]];
    const offset = sub(corner, target);
    const [across, along, depth] = [Math.abs(dot(offset, right)), Math.abs(dot(offset, upward)), dot(offset, forward)];
    distance = Math.max(distance, along / slope - depth, across / (slope * aspect) - depth);
    half = Math.max(half, along, across / aspect);
  }
  if (orthographic) {
    return { ...probe, eye: add(target, scale(towards, 2 * size)), height: 2 * MARGIN * half || 1 };
  }
  return { ...probe, eye: add(target, scale(towards, Math.max(distance, 1e-3 * size))) };
}

/**
 * Turn around the target. Angles in radians; the camera's own `up` is the axis.
 * @param {Camera} camera @param {number} turn @param {number} raise @returns {Camera}
 */
export function orbit(camera, turn, raise) {
  const axis = unit(camera.up);
  const { right } = basis(camera);
  const offset = sub(camera.eye, camera.target);
  const distance = length(offset);
  const elevation = Math.asin(Math.max(-1, Math.min(1, dot(offset, axis) / distance)));
  const wanted = Math.max(-ELEVATION_MAX, Math.min(ELEVATION_MAX, elevation + raise));
  const towardsViewer = cross(right, axis); // horizontal
  const turned = rotate(towardsViewer, axis, turn);
  const towards = add(scale(turned, Math.cos(wanted)), scale(axis, Math.sin(wanted)));
  return { ...camera, eye: add(camera.target, scale(towards, distance)) };
}

/** @param {Vec} v @param {Vec} axis @param {number} angle @returns {Vec} */
function rotate(v, axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return add(add(scale(v, c), scale(cross(axis, v), s)), scale(axis, dot(axis, v) * (1 - c)));
}

/** World units that one picture height spans at the target. @param {Camera} camera */
export const heightAtTarget = (camera) =>
  camera.height === null ? 2 * halfHeight(camera) * length(sub(camera.target, camera.eye)) : camera.height;

/** Shift the picture by fractions of its height. @param {Camera} camera @param {number} x @param {number} y @returns {Camera} */
export function pan(camera, x, y) {
  const { right, up } = basis(camera);
  const h = heightAtTarget(camera);
  const shift = add(scale(right, -x * h), scale(up, -y * h));
  return { ...camera, eye: add(camera.eye, shift), target: add(camera.target, shift) };
}

/**
 * Come closer by `factor` (< 1) or go back (> 1), keeping what is under (x, y) in place.
 * @param {Camera} camera @param {number} factor
 * @param {number} x fraction of the height, right of the centre @param {number} y above the centre
 * @returns {Camera}
 */
export function zoom(camera, factor, x = 0, y = 0) {
  const moved = pan(camera, -x * (1 - factor), -y * (1 - factor));
  if (moved.height !== null) return { ...moved, height: moved.height * factor };
  return { ...moved, eye: add(moved.target, scale(sub(moved.eye, moved.target), factor)) };
}

/** Switch between perspective and orthographic, keeping the size of things at the target. @param {Camera} camera @returns {Camera} */
export function toggleProjection(camera) {
  const offset = sub(camera.eye, camera.target);
  if (camera.height === null) {
    const height = heightAtTarget(camera);
    // Far enough back that nothing of the scene (about 2 units wide) is behind the eye.
    return { ...camera, height, eye: add(camera.target, scale(unit(offset), Math.max(4, length(offset)))) };
  }
  const distance = camera.height / (2 * Math.tan((camera.fov * Math.PI) / 360));
  return { ...camera, height: null, eye: add(camera.target, scale(unit(offset), distance)) };
}
