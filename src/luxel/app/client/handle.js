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
    state: () => {
      const { drawing: { renderer, film, canvas }, light, notices } = app;
      return {
        ...light.counts(),
        requested: light.requests.count, received: light.received, evicted: light.store.evicted, dropped: light.store.dropped,
        baked: light.baked?.description.kind ?? null,
        known: film.listed.central, settled: film.settled, particles: app.scene?.count ?? 0, loaded: renderer.loaded,
        arrived: app.arrival.active ? app.arrival.done : app.spheres.complete, room: app.spheres.shown.count,
        samples: film.shown?.count ?? 0, frames: renderer.frameCount, frameMs: renderer.frameMs, fps: notices.fps,
        width: canvas.width, height: canvas.height, key: light.state?.key ?? "", model: light.state?.model ?? "",
        beside: app.beside.counts(), split: renderer.split, playing: app.player.playing, frame: app.scene?.frame ?? -1,
        coloring: app.coloring.current, hidden: app.spheres.shown.hiddenCount, connected: app.connection.connected,
        troubles: Object.fromEntries(notices.troubles), renderer: renderer.name,
      };
    },
    /** The camera in file units. */
    camera: () => app.viewpoint.camera && cameraToFile(app.viewpoint.camera, app.scene),
    /** @param {Camera} camera in file units */
    setCamera: (camera) => app.viewpoint.set(cameraFromFile(camera, app.scene)),
    /** All that makes this picture, see luxel.SavedView. */
    savedView: () => app.saved.current,
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
    /** Whether the server draws, whether what it sent is what is wanted now, and the message of that picture. */
    remote: () => {
      const { remote } = app, { width, height } = remote.canvas;
      return { active: remote.active, current: remote.current, sent: remote.sent, shown: remote.shown, width, height };
    },
    /** The picture that the server sent (RGBA), rows from the top, as base64. */
    remotePixels: () => {
      const { canvas } = app.remote, { width, height } = canvas;
      const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
      copy?.drawImage(canvas, 0, 0);
      return copy ? base64(copy.getImageData(0, 0, width, height).data) : "";
    },
    /** The picture (RGBA) and ids of pixel centres, rows from the bottom, as base64. */
    capture: () => {
      app.drawing.upload(); // what came since the last frame counts
      const { width, height, pixels, ids } = app.drawing.renderer.capture(/** @type {Camera} */ (app.viewpoint.camera));
      return { width, height, pixels: base64(pixels), ids: base64(ids) };
    },
  };
}
