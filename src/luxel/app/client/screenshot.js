// The picture as a file: drawn by the server in any size, or, where there is none, what the canvas shows.

import { download } from "./dom.js";
import { KIND, encode } from "./protocol.js";
import { viewJson } from "./views.js";

/** @typedef {import("./app.js").App} App */

export class Screenshot {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.waits = false;
    this.sized = false; // by the user
    /** @type {Uint8Array[]} */
    this.parts = [];
    this.confirmed = 0;
    /** What becomes of the file. @type {(file: Blob) => void} */
    this.deliver = (file) => download(file, `${this.app.scene?.title ?? "luxel"}.png`);
    app.element("save").addEventListener("click", () => this.press());
    for (const id of ["save-width", "save-height"]) app.element(id).addEventListener("input", () => { this.sized = true; });
  }

  /** A new connection: what an earlier one was asked for will not come. */
  connected() {
    this.confirmed = 0;
    this.end();
    this.app.element("save-size").hidden = !this.app.connection.live;
  }

  /** Offer the size of what is on screen, until somebody wants another. @param {number} width @param {number} height */
  fit(width, height) {
    if (this.sized) return;
    this.app.element("save-width").value = String(width);
    this.app.element("save-height").value = String(height);
  }

  press() {
    const { app } = this;
    if (app.scene === null) return;
    if (!app.connection.live) return app.drawing.save();
    if (this.waits) {
      app.connection.send(encode(KIND.cancelScreenshot, {}));
      return this.end();
    }
    const sides = ["save-width", "save-height"].map((id) => app.element(id));
    for (const side of sides) if (!side.reportValidity()) return;
    const [width, height] = sides.map((side) => side.valueAsNumber);
    this.parts = [];
    this.waits = true;
    app.connection.send(encode(KIND.takeScreenshot, { view: viewJson(app.panel.settings, app.viewpoint.camera, app.scene), width, height }));
    this.show(0);
  }

  /** @param {any} head */
  takeState({ done, total }) {
    if (!this.waits) return;
    if (total === 0) this.end();
    else this.show(done / total);
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takePart({ start, size }, { data }) {
    this.confirmed++;
    this.app.connection.send(encode(KIND.confirmParts, { parts: this.confirmed }));
    if (!this.waits) return; // cancelled while it was on its way
    if (start === 0) this.parts = [];
    this.parts.push(data);
    if (start + data.length < size) return;
    const file = new Blob(/** @type {BlobPart[]} */ (this.parts), { type: "image/png" });
    this.end();
    this.deliver(file);
  }

  end() {
    this.waits = false;
    this.parts = [];
    this.show(null);
  }

  /** @param {number | null} done a part of 1; null when nothing is under way */
  show(done) {
    const progress = /** @type {HTMLProgressElement} */ (/** @type {any} */ (this.app.element("save-progress")));
    progress.hidden = done === null;
    progress.value = done ?? 0;
    this.app.element("save").textContent = done === null ? "Save PNG" : "Cancel";
  }
}
