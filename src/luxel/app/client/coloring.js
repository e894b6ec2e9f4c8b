// What colour particles have: asks for scalars and colour maps as they are needed, and draws the colour bar.

import { RGB, drawColorbar, grading, isCategorical, normalised, packed, rgb, toLinear } from "./colors.js";
import { KIND, encode } from "./protocol.js";

/** @typedef {import("./app.js").App} App */
/** @typedef {import("./colors.js").Scalar} Scalar */

export class Coloring {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {Map<string, Scalar>} */
    this.scalars = new Map();
    /** @type {Map<string, Uint8Array>} */
    this.luts = new Map();
    this.asked = new Set();
    /** Names the values and the map that the renderer has. */
    this.current = "";
    /** Values for the renderer, of particles from one to another. @type {((start: number, end: number) => Float32Array) | null} */
    this.paint = null;
  }

  /** Whether values or the map that should be shown have not come yet. */
  get waiting() {
    return this.app.panel.settings.colorBy !== null && this.current === "";
  }

  get look() {
    return this.app.drawing.renderer.look;
  }

  /** Another data set: its values have to come first. */
  reset() {
    this.scalars.clear();
    this.asked.clear();
    this.current = "";
    this.paint = null;
  }

  /** Values are needed from now on, and some scalars came without. */
  forgetRanges() {
    for (const [name, { values }] of this.scalars) {
      if (values.length) continue;
      this.scalars.delete(name);
      this.asked.delete(`${KIND.scalarRequest} ${name}`);
    }
    this.app.spheres.applyHiding();
    this.changed();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeScalar(head, arrays) {
    const { scene, panel } = this.app;
    if (head.epoch !== scene?.epoch) return;
    let about = head, { values } = arrays;
    if (this.parted) {
      const whole = this.app.arrival.takeScalar(head, values);
      if (whole === null) return;
      ({ head: about, values } = whole);
    }
    const { labels } = scene.scalars.find((/** @type {any} */ each) => each.name === head.name) ?? { labels: null };
    this.scalars.set(head.name, { values, range: about.range, logRange: about.log_range, whole: about.whole, missing: about.missing, labels });
    panel.hiding.show();
    this.app.spheres.applyHiding();
    this.changed();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeColormap(head, arrays) {
    this.luts.set(head.name, arrays.lut);
    this.changed();
  }

  /** Scalar, map, range or plain colour changed. */
  changed() {
    const { panel, drawing, scene } = this.app;
    const s = panel.settings;
    const { look } = this;
    look.color = rgb(s.color).map(toLinear);
    look.noData = rgb(s.noData).map(toLinear);
    const own = s.colorBy !== null && s.colormap === RGB;
    const scalar = s.colorBy === null || own ? null : this.scalars.get(s.colorBy);
    const lut = this.luts.get(s.colormap);
    if (own) {
      this.showOwnColors(/** @type {string} */ (s.colorBy));
    } else if (s.colorBy !== null && scalar === undefined) this.askFor(KIND.scalarRequest, s.colorBy);
    if (s.colorBy !== null && !own && lut === undefined) this.askFor(KIND.colormapRequest, s.colormap);
    if (s.colorBy === null) {
      look.uniform = true;
      this.paint = null;
    } else if (scalar && lut) {
      const wanted = JSON.stringify([scene.epoch, s.colorBy, s.colormap, s.range, s.log]);
      if (wanted !== this.current && scalar.values.length) {
        const { range, log } = s, rows = lut.length / 3;
        this.paint = (start, end) => normalised({ ...scalar, values: scalar.values.subarray(start, end) }, rows, range, log);
        drawing.renderer.setValues(this.paint(0, scalar.values.length));
        drawing.renderer.setLut(lut);
        this.current = wanted;
      }
      look.uniform = look.packed = false;
      panel.setShownRange(s.log ? scalar.logRange : scalar.range);
    }
    this.drawBar();
    drawing.lightChanged();
  }

  /** Show a vector's components as colours, once they are all here. @param {string} name */
  showOwnColors(name) {
    const names = ["x", "y", "z"].map((component) => `${name}.${component}`);
    const channels = names.flatMap((each) => this.scalars.get(each) ?? []);
    this.askForScalars(names.filter((each) => !this.scalars.has(each)));
    if (channels.length < 3 || !channels[0].values.length) return;
    const wanted = JSON.stringify([this.app.scene.epoch, name, RGB]);
    if (wanted !== this.current) {
      this.paint = (start, end) => packed(channels.map((each) => ({ ...each, values: each.values.subarray(start, end) })));
      this.app.drawing.renderer.setValues(this.paint(0, channels[0].values.length));
      this.current = wanted;
    }
    this.look.uniform = false;
    this.look.packed = true;
  }

  /** Particles have come, and their values before them. @param {number} start @param {number} count */
  extend(start, count) {
    if (this.paint !== null) this.app.drawing.renderer.setValues(this.paint(start, start + count), start);
  }

  /** Whether scalars come part by part. */
  get parted() {
    return this.app.arrival.active && !this.app.remote.active;
  }

  /** @param {number} kind @param {string} name */
  askFor(kind, name) {
    const key = `${kind} ${name}`;
    if (this.asked.has(key)) return;
    this.asked.add(key);
    if (kind === KIND.scalarRequest && this.parted) return this.app.arrival.askFor(name);
    this.app.connection.send(encode(kind, { name }));
  }

  /** @param {string[]} names */
  askForScalars(names) {
    for (const name of names) this.askFor(KIND.scalarRequest, name);
  }

  drawBar() {
    const s = this.app.panel.settings;
    const scalar = s.colorBy === null ? undefined : this.scalars.get(s.colorBy);
    const lut = this.luts.get(s.colormap);
    if (s.colorBy === null || !scalar || !lut) return;
    const rows = lut.length / 3;
    const codes = isCategorical(scalar, rows, s.range, s.log);
    const labels = codes ? scalar.labels ?? Array.from({ length: Math.min(rows, 1 + Math.max(0, scalar.range[1])) }, (_, k) => String(k)) : null;
    drawColorbar(this.app.element("bar"), {
      lut, log: s.log, title: s.colorBy, labels,
      range: s.range ?? (s.log ? scalar.logRange : scalar.range),
      noData: (scalar.missing ?? scalar.values.some(Number.isNaN)) ? s.noData : null,
    });
  }

  /** Exposure or background changed. */
  toneChanged() {
    const s = this.app.panel.settings;
    const { top, bottom } = grading(s.background);
    Object.assign(this.look, { exposure: s.exposure, top, bottom });
    this.drawBar();
    this.app.drawing.toneChanged();
  }
}
