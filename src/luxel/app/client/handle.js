// `window.luxel`: what tests and the browser's console can see and do.

import { App } from "./app.js";
import { KIND, encode } from "./protocol.js";
import { cameraFromFile, cameraToFile } from "./views.js";

/** @typedef {import("./camera.js").Camera} Camera */

/** @param {App} app */
export function handle(app) {
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
      coloring: app.coloring, hidden: app.shown.hiddenCount, connected: app.connection.connected, troubles: Object.fromEntries(app.troubles),
      renderer: app.renderer.name,
    }),
    /** The camera in file units. */
    camera: () => app.camera && cameraToFile(app.camera, app.scene),
    /** @param {Camera} camera in file units */
    setCamera: (camera) => app.setCamera(cameraFromFile(camera, app.scene)),
    /** All that makes this picture, see luxel.SavedView. */
    savedView: () => app.savedView(),
    /** Resolves once the server has acted on all that this page has said, and no change waits to be sent. */
    synced: async () => {
      while (app.pending) await new Promise(requestAnimationFrame);
      await new Promise((resolve) => {
        app.receive = (message) => {
          App.prototype.receive.call(app, message);
          if (message.kind !== KIND.particle) return;
          app.receive = App.prototype.receive;
          resolve(true);
        };
        app.connection.send(encode(KIND.inspect, { id: 0 })); // messages of a page are acted on in turn
      });
      return true;
    },
    /** The picture (RGBA) and ids of pixel centres, rows from the bottom, as base64. */
    capture: () => {
      app.upload(); // what came since the last frame counts
      const { width, height, pixels, ids } = app.renderer.capture(/** @type {Camera} */ (app.camera));
      return { width, height, pixels: base64(pixels), ids: base64(ids) };
    },
  };
}
