// `window.luxel`: what tests and the browser's console can see and do.

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vec} Vec */

/** @param {import("./app.js").App} app */
export function handle(app) {
  const toFile = (/** @type {number[]} */ p) => p.map((x, k) => app.scene.center[k] + app.scene.unit * x);
  const fromFile = (/** @type {number[]} */ p) => /** @type {Vec} */ (p.map((x, k) => (x - app.scene.center[k]) / app.scene.unit));
  const base64 = (/** @type {ArrayBufferView} */ view) => {
    const bytes = new Uint8Array(view.buffer, view.byteOffset, view.byteLength);
    let text = "";
    for (let k = 0; k < bytes.length; k += 32768) text += String.fromCharCode(...bytes.subarray(k, k + 32768));
    return btoa(text);
  };
  return {
    app,
    /** Where things stand. */
    state: () => ({
      ...app.counts(),
      requested: app.sight.requested, received: app.tilesReceived, evicted: app.store.evicted, dropped: app.store.dropped, baked: app.baked?.description.kind ?? null,
      known: app.film.listed.central, settled: app.film.settled, particles: app.scene?.count ?? 0, loaded: app.renderer.loaded,
      samples: app.film.shown?.count ?? 0, frames: app.renderer.frameCount, frameMs: app.renderer.frameMs, fps: app.fps,
      width: app.canvas.width, height: app.canvas.height, key: app.light?.key ?? "", model: app.light?.model ?? "",
      coloring: app.coloring, connected: app.connection.connected, troubles: Object.fromEntries(app.troubles),
      renderer: app.renderer.name,
    }),
    /** The camera in file units. */
    camera: () => app.camera && {
      ...app.camera, eye: toFile(app.camera.eye), target: toFile(app.camera.target),
      height: app.camera.height === null ? null : app.camera.height * app.scene.unit,
    },
    /** @param {Camera} camera in file units */
    setCamera: (camera) => app.setCamera({
      ...camera, eye: fromFile(camera.eye), target: fromFile(camera.target),
      height: camera.height == null ? null : camera.height / app.scene.unit,
    }),
    /** The picture (RGBA) and ids of pixel centres, rows from the bottom, as base64. */
    capture: () => {
      app.upload(); // what came since the last frame counts
      const { width, height, pixels, ids } = app.renderer.capture(/** @type {Camera} */ (app.camera));
      return { width, height, pixels: base64(pixels), ids: base64(ids) };
    },
  };
}
