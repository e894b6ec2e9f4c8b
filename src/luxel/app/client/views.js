// Views as JSON, in file units: what luxel.View, saved views and messages hold; the page itself works in normalised units.

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vec} Vec */
/** @typedef {import("./hiding.js").Space} Space */

/** @param {Vec} p @param {Space} space @returns {Vec} */
export const pointToFile = (p, { center, unit }) => [center[0] + unit * p[0], center[1] + unit * p[1], center[2] + unit * p[2]];

/** @param {number[]} p @param {Space} space @returns {Vec} */
export const pointFromFile = (p, { center, unit }) => [(p[0] - center[0]) / unit, (p[1] - center[1]) / unit, (p[2] - center[2]) / unit];

/** @param {Camera} camera @param {Space} space @returns {Camera} */
export const cameraToFile = (camera, space) => ({
  ...camera, eye: pointToFile(camera.eye, space), target: pointToFile(camera.target, space),
  height: camera.height === null ? null : camera.height * space.unit,
});

/** @param {any} camera @param {Space} space @returns {Camera} */
export const cameraFromFile = (camera, space) => ({
  ...camera, eye: pointFromFile(camera.eye, space), target: pointFromFile(camera.target, space),
  height: camera.height == null ? null : camera.height / space.unit,
});

/**
 * The settings of a page as ``View.to_json()`` has them.
 * @param {import("./panel.js").Settings} s @param {Camera | null} camera normalised @param {Space} space
 */
export const viewJson = (s, camera, space) => ({
  camera: camera && cameraToFile(camera, space),
  color_by: s.colorBy, colormap: s.colormap, range: s.range, log: s.log, exposure: s.exposure,
  background: s.background, up: s.up, color: s.color, nan_color: s.noData, hide: s.hide,
});

/** The settings that a view asks for. @param {any} view @returns {import("./panel.js").Settings} */
export const settingsOf = (view) => ({
  colorBy: view.color_by, colormap: view.colormap, range: view.range, log: view.log, exposure: view.exposure,
  background: view.background, up: view.up, color: view.color, noData: view.nan_color, hide: view.hide,
});
