// The controls beside the picture: native inputs, read into one plain object of settings.

import { upFrame } from "./camera.js";
import { RGB, rgb } from "./colors.js";
import { debounced, fill, finder } from "./dom.js";
import { HidePanel } from "./hide_panel.js";
import { settingsOf } from "./views.js";

export { finder };

/**
 * @typedef {object} Settings
 * @property {string | null} colorBy
 * @property {string} colormap
 * @property {[number, number] | null} range null follows the data
 * @property {boolean} log
 * @property {string} color
 * @property {string} noData
 * @property {number} exposure
 * @property {string} background
 * @property {string} up
 * @property {import("./hiding.js").Condition[]} hide without change of light
 */

/**
 * @typedef {object} Listener
 * @property {() => void} color scalar, map, range or plain colour changed
 * @property {() => void} tone exposure or background changed
 * @property {(change: {model?: string, sky?: number, sun?: number[], up?: string, radius_scale?: number}) => void} light
 * @property {() => void} up another axis points up
 * @property {(scale: number) => void} radius a slider is being moved; the light follows
 * @property {(conditions: import("./hide_panel.js").Conditions) => void} hide
 * @property {() => number[]} towardsMe unit vector from the target to the eye
 * @property {(name: string) => [number, number] | null} rangeOf of a scalar, once it is here
 * @property {() => void} saveView
 * @property {(text: string) => void} loadView
 * @property {(frame: number) => void} frame
 * @property {() => void} play or stop playing
 * @property {(by: 1 | -1) => void} step to the next time step, or to the one before
 * @property {() => void} fit
 * @property {(axis: string, negative: boolean) => void} axis
 * @property {() => void} projection
 * @property {() => void} layout the panel was shown or hidden
 * @property {(title: string) => void} titled the data set has a name
 */

const LIGHT_DELAY_MS = 120; // after the last movement of a slider
export const MODEL_NAMES = /** @type {Record<string, string>} */ ({
  lambertian: "Lambertian", shadows: "Soft shadows", ao: "Ambient occlusion", interreflection: "Global illumination",
});

export class Panel {
  /** @param {HTMLElement} root @param {Listener} listener */
  constructor(root, listener) {
    this.root = root;
    this.element = finder(root);
    this.listener = listener;
    this.hiding = new HidePanel(root, listener);
    this.lastColormap = "viridis";
    /** @type {any} */
    this.scene = null;
    /** @type {Settings} */
    this.settings = {
      colorBy: null, colormap: "viridis", range: null, log: false, color: "#d9d5cc", noData: "#7f7f86", exposure: 1, background: "#17191d",
      up: "z", hide: [],
    };
    const s = this.settings;
    /** @type {(id: string, type: string, action: (input: HTMLInputElement) => void) => void} */
    const on = (id, type, action) => {
      const input = this.element(id);
      input.addEventListener(type, () => action(input));
    };
    on("color-by", "change", (input) => {
      s.colorBy = input.value || null;
      s.range = null;
      this.fitColormap();
      this.color();
    });
    on("colormap", "change", (input) => { s.colormap = input.value; if (s.colormap !== RGB) this.lastColormap = s.colormap; this.color(); });
    on("log", "change", (input) => { s.log = input.checked; s.range = null; this.color(); });
    on("auto", "change", (input) => { s.range = input.checked ? null : this.typedRange(); this.color(); });
    for (const id of ["low", "high"]) on(id, "change", () => { s.range = this.typedRange() ?? s.range; this.color(); });
    on("color", "input", (input) => { s.color = input.value; this.color(); });
    on("exposure", "input", (input) => { s.exposure = 2 ** input.valueAsNumber; this.show(); listener.tone(); });
    on("background", "input", (input) => { s.background = input.value; this.show(); listener.tone(); });
    on("model", "change", (input) => listener.light({ model: input.value }));
    const sky = debounced(() => listener.light({ sky: this.sky(), up: s.up }), LIGHT_DELAY_MS);
    const sun = debounced(() => listener.light({ sun: this.sun(), up: s.up }), LIGHT_DELAY_MS);
    on("sky", "input", () => { this.show(); sky(); });
    for (const id of ["sun", "azimuth", "elevation", "diameter"]) on(id, "input", () => { this.show(); sun(); });
    on("up", "change", (input) => { s.up = input.value; listener.up(); });
    const radius = debounced(() => listener.light({ radius_scale: this.radiusScale }), LIGHT_DELAY_MS);
    on("radius", "input", () => { this.show(); listener.radius(this.radiusScale); radius(); });
    on("view-save", "click", () => listener.saveView());
    on("view-load", "click", () => this.element("view-file").click());
    on("view-file", "change", (input) => {
      input.files?.[0]?.text().then((text) => listener.loadView(text));
      input.value = ""; // so that the same file can be chosen again
    });
    const frame = debounced(() => listener.frame(this.element("frame").valueAsNumber), LIGHT_DELAY_MS);
    on("frame", "input", () => { this.show(); frame(); });
    /** Changes that the server does not know yet, by the control. @type {Record<string, {pending: () => boolean}>} */
    this.changes = { sky, radius, sun, azimuth: sun, elevation: sun, diameter: sun, frame };
    on("frame-all", "click", () => listener.fit());
    on("orthographic", "change", () => listener.projection());
    for (const button of root.querySelectorAll("[data-axis]")) {
      const axis = /** @type {HTMLElement} */ (button).dataset.axis ?? "x";
      button.addEventListener("click", (event) => listener.axis(axis, /** @type {MouseEvent} */ (event).shiftKey));
    }
    on("fold", "click", () => this.fold());
    root.addEventListener("keydown", (event) => this.key(event));
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const { target } = event;
    const typing = target instanceof HTMLSelectElement || (target instanceof HTMLInputElement && target.type !== "range");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "p") this.fold();
    else if (event.key === "." || event.key === ",") this.listener.step(event.key === "." ? 1 : -1);
    // On buttons and headings, the space bar means them.
    else if (event.key === " " && !(target instanceof HTMLElement && target.closest("button, summary"))) {
      this.listener.play();
      event.preventDefault();
    }
  }

  fold() {
    const folded = this.root.classList.toggle("folded");
    this.element("fold").setAttribute("aria-expanded", String(!folded));
    this.listener.layout();
  }

  /** Colours are shown as they are until somebody wants a map, and nothing else ever is. */
  fitColormap() {
    const s = this.settings;
    const colors = this.scene.scalars.some((/** @type {any} */ each) => each.name === s.colorBy && each.colors);
    if (colors !== (s.colormap === RGB)) s.colormap = colors ? RGB : this.lastColormap;
    const known = /** @type {string[]} */ (this.scene.colormaps);
    const maps = s.colormap === RGB || known.includes(s.colormap) ? known : [s.colormap, ...known];
    const options = maps.map((name) => /** @type {[string, string]} */ ([name, name]));
    fill(this.element("colormap"), colors ? [[RGB, "own colours"], ...options] : options);
  }

  color() {
    this.show();
    this.listener.color();
  }

  /** @returns {[number, number] | null} what is typed, if it makes sense */
  typedRange() {
    const [low, high] = [this.element("low").valueAsNumber, this.element("high").valueAsNumber];
    return low < high && (!this.settings.log || low > 0) ? [low, high] : null;
  }

  sun() {
    return [this.element("azimuth").valueAsNumber, this.element("elevation").valueAsNumber, this.element("sun").valueAsNumber, this.element("diameter").valueAsNumber];
  }

  sky() {
    return this.element("sky").valueAsNumber;
  }

  /** Whether a control is ahead of the server, and must be left alone: it is being dragged, or its change is on its way. @param {string} id */
  ahead(id) {
    return this.changes[id].pending() || this.element(id).matches(":focus");
  }

  get radiusScale() {
    return Number((2 ** this.element("radius").valueAsNumber).toPrecision(4));
  }

  /** Take over a data set and its view. @param {any} scene @param {boolean} keep the user's own settings */
  setScene(scene, keep) {
    const s = this.settings;
    if (!keep) Object.assign(s, settingsOf(scene.view));
    this.scene = scene;
    this.refresh();
    fill(this.element("model"), scene.models.map((/** @type {string} */ name) => [name, MODEL_NAMES[name] ?? name]));
    this.hiding.setScene(scene);
    for (const id of ["model", "sky", "sun", "azimuth", "elevation", "diameter", "radius"]) this.element(id).disabled = scene.light_fixed;
    this.element("title").textContent = scene.title;
    this.listener.titled(scene.title);
    const time = scene.time === null ? "" : ` · t = ${Number(scene.time.toPrecision(6))}`;
    this.element("summary").textContent = `${scene.count.toLocaleString("en")} particles${time}`;
    this.element("time-part").hidden = scene.frame_count < 2;
    this.element("frame").max = String(scene.frame_count - 1);
    if (!this.changes.frame.pending()) this.element("frame").value = String(scene.frame); // else it is being moved
    this.show();
  }

  /** Take over settings that were changed elsewhere. */
  refresh() {
    const { scene, settings: s } = this;
    const names = /** @type {string[]} */ (scene.scalars.map((/** @type {any} */ each) => each.name));
    if (s.colorBy !== null && !names.includes(s.colorBy)) s.colorBy = null;
    fill(this.element("color-by"), [["", "nothing"], ...names.map((name) => /** @type {[string, string]} */ ([name, name]))]);
    if (s.colormap !== RGB) this.lastColormap = s.colormap;
    this.fitColormap();
    this.show();
  }

  /** @param {any} light head of a light message */
  setLight(light) {
    this.element("model").value = light.model;
    const { lights, radius_scale: scale } = light.lighting;
    const kind = (/** @type {string} */ name) => lights.find((/** @type {any} */ each) => each.kind === name);
    const [sky, sun] = [kind("Sky"), kind("Sun")];
    const shown = /** @type {Record<string, number>} */ ({ sky: sky?.level ?? 0, sun: sun?.level ?? 0, radius: Math.log2(scale) });
    if (sun) Object.assign(shown, anglesOf(sun.direction, this.settings.up), { diameter: sun.angular_diameter });
    for (const [id, value] of Object.entries(shown)) {
      if (!this.ahead(id)) this.element(id).value = String(value);
    }
    this.root.classList.toggle("no-lights", light.model === "ao");
    this.show();
  }

  /** The range in use now, when it follows the data. @param {[number, number]} range */
  setShownRange(range) {
    if (this.settings.range !== null) return;
    this.element("low").value = String(Number(range[0].toPrecision(5)));
    this.element("high").value = String(Number(range[1].toPrecision(5)));
  }

  /** Bring the controls in line with the settings. */
  show() {
    const s = this.settings;
    this.element("color-by").value = s.colorBy ?? "";
    this.element("colormap").value = s.colormap;
    this.element("log").checked = s.log;
    this.element("auto").checked = s.range === null;
    if (s.range !== null) [this.element("low").value, this.element("high").value] = s.range.map(String);
    this.element("color").value = s.color;
    this.element("background").value = s.background;
    this.element("up").value = s.up;
    this.element("exposure").value = String(Math.log2(s.exposure));
    const outputs = /** @type {Record<string, string>} */ ({
      exposure: `× ${s.exposure.toFixed(2)}`, sky: this.element("sky").valueAsNumber.toFixed(2), sun: this.element("sun").valueAsNumber.toFixed(1),
      azimuth: `${this.element("azimuth").value}°`, elevation: `${this.element("elevation").value}°`, diameter: `${this.element("diameter").value}°`, radius: `× ${this.radiusScale.toPrecision(3)}`,
      frame: `${this.element("frame").value} / ${this.element("frame").max}`,
    });
    for (const [id, text] of Object.entries(outputs)) this.element(`${id}-out`).textContent = text;
    this.root.classList.toggle("uniform", s.colorBy === null);
    this.root.classList.toggle("coloured", s.colorBy !== null);
    this.root.classList.toggle("own-colors", s.colorBy !== null && s.colormap === RGB);
    const [r, g, b] = rgb(s.background);
    this.element("stage").classList.toggle("bright", 0.3 * r + 0.59 * g + 0.11 * b > 0.5);
  }
}

/** Azimuth and elevation in degrees. @param {number[]} towards @param {string} up */
function anglesOf(towards, up) {
  const [x, y, z] = upFrame(up).map((axis) => axis.reduce((sum, a, k) => sum + a * towards[k], 0));
  const degrees = (/** @type {number} */ angle) => Number(((angle * 180) / Math.PI).toFixed(3));
  return { azimuth: degrees(Math.atan2(y, x) + (y < 0 ? 2 * Math.PI : 0)), elevation: degrees(Math.asin(Math.max(-1, Math.min(1, z)))) };
}
