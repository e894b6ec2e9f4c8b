// The picture on its canvas: fitted to its place, drawn when something changed, made anew after a lost graphics context.

import { download } from "./dom.js";
import { Film } from "./film.js";
import { NoRenderer } from "./norenderer.js";
import { Overlay } from "./overlay.js";
import { Renderer } from "./renderer.js";

/** @typedef {import("./app.js").App} App */

const PIXELS_MAX = 4_000_000;
const HOLD_MS = 1000; // for which the last picture stays until the next time step is all there

export class Drawing {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.stage = app.element("stage");
    /** @type {HTMLCanvasElement} */
    this.canvas = app.element("view");
    this.overlay = new Overlay(/** @type {any} */ (app.element("overlay")));
    /** Why this browser cannot draw, if it cannot. @type {string | null} */
    this.trouble = null;
    this.renderer = this.makeRenderer();
    this.film = this.makeFilm();
    this.scheduled = false;
    this.heldUntil = 0;
    const { signal } = app.closing;
    this.canvas.addEventListener("webglcontextlost", (event) => {
      if (signal.aborted) return;
      event.preventDefault(); // or it would never come back
      app.notices.trouble("graphics", "The graphics context was lost — waiting for the browser to restore it …");
      app.report("graphics context lost");
    });
    this.canvas.addEventListener("webglcontextrestored", () => this.restore());
    const resizes = new ResizeObserver(() => this.resize());
    resizes.observe(this.stage);
    signal.addEventListener("abort", () => resizes.disconnect());
  }

  /** The renderer, or where there can be none, what stands in for it while the server draws. */
  makeRenderer() {
    try {
      return new Renderer(this.canvas);
    } catch (error) {
      if (!this.app.connection.live) throw error;
      this.trouble = error instanceof Error ? error.message : String(error);
      return /** @type {Renderer} */ (/** @type {unknown} */ (new NoRenderer(this.canvas)));
    }
  }

  makeFilm() {
    const { light } = this.app;
    return new Film(this.renderer, (data, stride, epoch) => {
      light.sight.collect(data, stride, epoch);
      light.ask();
    }, () => light.sight.ids.subarray(0, light.sight.count), () => light.awaited);
  }

  get aspect() {
    return this.canvas.width / this.canvas.height;
  }

  /** Light or colours changed. */
  lightChanged() {
    this.film.lightChanged();
    this.schedule();
  }

  /** Exposure or background changed. */
  toneChanged() {
    this.film.toneChanged();
    this.schedule();
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, Math.sqrt(PIXELS_MAX / Math.max(1, this.stage.clientWidth * this.stage.clientHeight)));
    const width = Math.max(1, Math.round(this.stage.clientWidth * ratio));
    const height = Math.max(1, Math.round(this.stage.clientHeight * ratio));
    if (width !== this.canvas.width || height !== this.canvas.height || this.renderer.targets === null) {
      this.canvas.width = width;
      this.canvas.height = height;
      this.guard(() => this.renderer.resize());
      this.film.restart();
    }
    this.app.screenshot.fit(width, height);
    this.app.coloring.drawBar();
    this.drawOverlay();
    this.schedule();
  }

  schedule() {
    if (this.scheduled) return;
    this.scheduled = true;
    requestAnimationFrame(() => {
      this.scheduled = false;
      if (this.app.closing.signal.aborted) return;
      this.guard(() => this.step());
    });
  }

  step() {
    if (this.app.remote.active) return this.app.remote.step();
    if (this.renderer.gl.isContextLost()) return;
    const { app } = this;
    if (this.held) return this.schedule();
    this.upload();
    const more = this.film.step();
    app.arrival.tick();
    app.notices.tick();
    app.player.tick();
    app.study.tick();
    if (more) this.schedule();
    else app.notices.show(); // what is told at rest is the last word
  }

  /** Rather show the last time step a little longer than half of the next. */
  hold() {
    this.heldUntil = performance.now() + HOLD_MS;
  }

  get held() {
    const { spheres, coloring } = this.app;
    return this.film.shown === null && (!spheres.complete || coloring.waiting) && performance.now() < this.heldUntil;
  }

  /** Send what light came to the graphics processor. */
  upload() {
    for (const set of this.renderer.sets) set.upload();
  }

  /** Run what may fail for lack of graphics, and say so. @param {() => void} action */
  guard(action) {
    try {
      action();
    } catch (error) {
      const text = error instanceof Error ? error.message : String(error);
      this.app.notices.trouble("graphics", text);
      this.app.report(text);
      throw error;
    }
  }

  /** After a lost context everything on the graphics processor is gone; memory has it all. */
  restore() {
    const { app } = this;
    this.guard(() => {
      this.renderer = new Renderer(this.canvas);
      this.film = this.makeFilm();
      this.resize();
      if (app.scene !== null) {
        this.renderer.setScene(app.spheres.shown.count, reach(app.scene), app.scene.first ? app.scene.count : 0);
        app.spheres.shown.dirty.all();
        app.spheres.flush();
      }
      app.light.restore();
      app.beside.restore();
      app.coloring.current = "";
      if (app.viewpoint.camera !== null) app.viewpoint.set(app.viewpoint.camera);
      app.coloring.changed();
      app.coloring.toneChanged();
    });
    app.notices.trouble("graphics", null);
  }

  /** Axes, scale bar and what was picked. */
  drawOverlay() {
    const { scene, viewpoint: { camera }, pick } = this.app;
    if (camera === null || scene === null) return;
    const at = this.overlay.draw(camera, scene, pick.sphere);
    pick.place(at, this.stage.clientWidth, this.stage.clientHeight);
  }

  /** Save what is shown as PNG. */
  save() {
    const { shown } = this.film;
    if (shown === null) return;
    const { width, height } = this.canvas;
    this.renderer.present(shown.pair, shown.count, { width: Math.floor(width * shown.scale), height: Math.floor(height * shown.scale), epoch: 0 });
    this.canvas.toBlob((blob) => {
      if (blob !== null) download(blob, `${this.app.scene?.title ?? "luxel"}.png`);
    });
  }
}

/** From the origin to the farthest corner of the data. @param {{bounds: number[][]}} scene */
export const reach = ({ bounds: [low, high] }) => Math.hypot(...low.map((x, k) => Math.max(-x, high[k])));
