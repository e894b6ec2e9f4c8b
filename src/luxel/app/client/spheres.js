// The particles as they are drawn: which of them are hidden, how large they are, and all of it on its way to the renderer.

import { debounced } from "./dom.js";
import { Shown } from "./hiding.js";
import { PARTICLES_WIDTH } from "./renderer.js";

/** @typedef {import("./app.js").App} App */
/** @typedef {import("./hiding.js").Condition} Condition */

const LIGHT_DELAY_MS = 120; // after the last movement of a slider

export class Spheres {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.shown = new Shown(0, PARTICLES_WIDTH);
    /** What is hidden from light too: as the server has it, or ahead of it while a slider moves. @type {Condition[]} */
    this.opened = [];
    this.sendOpened = debounced(() => app.light.send({ hide: this.opened }), LIGHT_DELAY_MS);
  }

  /** @param {number} count particles of another data set @param {number} scale of their radii */
  reset(count, scale) {
    this.shown = new Shown(count, PARTICLES_WIDTH);
    this.shown.setScale(scale);
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeGeometry(head, arrays) {
    if (head.epoch !== this.app.scene?.epoch) return;
    const { arrival, coloring, drawing } = this.app;
    if (arrival.active && !arrival.took(null, head.start)) return;
    const first = this.shown.loaded === 0;
    this.shown.put(head.start, arrays.positions, arrays.radii);
    if (!arrival.active) {
      this.upload();
      drawing.film.restart();
    } else {
      coloring.extend(head.start, arrays.radii.length);
      if (first) drawing.film.restart();
      // What comes to the rest of a picture is shown together: it begins anew each time.
      if (this.complete) this.upload();
      else this.flush();
    }
    drawing.schedule();
  }

  /** Whether all particles are here that have been asked for. */
  get complete() {
    const { arrival } = this.app, { loaded, count } = this.shown;
    return loaded === (arrival.active ? arrival.target : count);
  }

  /** What the light of the server hides and scales. @param {{hide: Condition[], radius_scale: number}} lighting */
  takeLight(lighting) {
    const { panel } = this.app;
    if (!this.sendOpened.pending()) {
      this.opened = lighting.hide;
      panel.hiding.take({ keeps: panel.settings.hide, opens: this.opened });
    }
    if (!panel.ahead("radius")) this.scaleRadii(lighting.radius_scale);
    this.applyHiding();
  }

  /** @param {Condition[]} keeps @param {Condition[]} opens */
  hideChanged(keeps, opens) {
    this.app.panel.settings.hide = keeps;
    if (JSON.stringify(opens) !== JSON.stringify(this.opened)) {
      this.opened = opens;
      this.sendOpened();
    }
    this.applyHiding();
  }

  applyHiding() {
    const { scene, panel, coloring, drawing } = this.app;
    if (scene === null) return;
    const { shown } = this;
    const changed = shown.hide([...panel.settings.hide, ...this.opened], coloring.scalars, scene);
    coloring.askForScalars(shown.missing);
    panel.hiding.showCount(shown.hiddenCount, shown.count);
    if (changed) this.upload();
    else drawing.schedule(); // where the server draws, it has to know
  }

  /** @param {number} scale of all radii */
  scaleRadii(scale) {
    if (this.shown.setScale(scale)) this.upload();
  }

  /** The spheres have changed, and with them what is visible. */
  upload() {
    const { drawing, viewpoint } = this.app;
    this.flush();
    drawing.drawOverlay();
    if (viewpoint.camera !== null) drawing.film.setCamera(viewpoint.camera); // as after a move: coarse at first, then everything anew
    drawing.schedule();
  }

  /** Send what changed to the renderer. */
  flush() {
    this.shown.flush((start, part) => this.app.drawing.renderer.setSpheres(start, part));
  }
}
