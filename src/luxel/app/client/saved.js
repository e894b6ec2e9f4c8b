// Views that are saved and loaded: all that makes a picture, as luxel.SavedView has it.

import { download } from "./dom.js";
import { KIND, encode } from "./protocol.js";
import { cameraFromFile, settingsOf, viewJson } from "./views.js";

/** @typedef {import("./app.js").App} App */

export class SavedViews {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
  }

  /** What is shown now. */
  get current() {
    const { scene, light, spheres, panel, viewpoint } = this.app;
    return {
      luxel_view: 1, frame: scene.frame, view: viewJson(panel.settings, viewpoint.camera, scene),
      light: scene.light_fixed ? null : { ...light.state.lighting, hide: spheres.opened, radius_scale: spheres.shown.scale },
    };
  }

  /** Hand it to the user as a file. */
  save() {
    const { scene, light } = this.app;
    if (scene === null || light.state === null) return;
    const text = `${JSON.stringify(this.current, null, 2)}\n`;
    download(new Blob([text], { type: "application/json" }), `${scene.title.replace(/\.\w+$/, "")}.view.json`);
  }

  /** @param {string} text of a file */
  load(text) {
    const { notices, connection } = this.app;
    let saved;
    try {
      saved = JSON.parse(text);
    } catch (error) {
      return notices.trouble("server", `This is no view: ${error instanceof Error ? error.message : error}`, true);
    }
    if (typeof saved !== "object" || saved === null || Array.isArray(saved)) return notices.trouble("server", "This is no view: it must be a JSON object", true);
    connection.send(encode(KIND.loadView, { saved }));
  }

  /** Show what the server found good. @param {any} view as of View.to_json() */
  take(view) {
    this.app.study.viewTaken();
    const { panel, scene, spheres, viewpoint, coloring } = this.app;
    Object.assign(panel.settings, settingsOf(view));
    panel.refresh();
    panel.hiding.take({ keeps: view.hide, opens: spheres.opened });
    if (view.camera) viewpoint.set(cameraFromFile(view.camera, scene));
    spheres.applyHiding();
    coloring.changed();
    coloring.toneChanged();
  }
}
