// A second shading model, to the right of a divider: a light of its own, and textures in a set of its own that the renderer
// draws there and nowhere else.

import { CoarseStore } from "./coarse.js";
import { Divider } from "./divider.js";
import { fill } from "./dom.js";
import { LightSet } from "./lightset.js";
import { MODEL_NAMES } from "./panel.js";
import { KIND, encode } from "./protocol.js";
import { PARTICLES_WIDTH } from "./renderer.js";
import { Requests } from "./sight.js";
import { ATLAS_BYTES, TileStore } from "./tiles.js";

/** @typedef {import("./app.js").App} App */

export class Beside {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** What the user wants to see on the right; "" for one picture without divider. */
    this.model = "";
    /** The light there, as in a light message; null while it has not come. @type {any} */
    this.state = null;
    /** Its textures; null where it needs none. @type {TileStore | null} */
    this.tiles = null;
    this.requests = new Requests(app.light.sight);
    this.divider = new Divider(app.root, (split) => this.splitAt(split));
    this.select = app.element("beside");
    this.select.addEventListener("change", () => this.choose(this.select.value));
  }

  /** Baked light has no second key; what Lambert needs is in the light message itself. */
  get local() {
    return this.app.scene?.light_fixed === true;
  }

  /** Show a model on the right; "" ends the comparison. @param {string} model */
  choose(model) {
    if (model === this.model) return;
    this.model = model;
    this.state = null;
    if (model === "") this.tiles = null;
    if (this.local) this.follow();
    else this.tell();
    this.apply();
  }

  /** Let the server know. */
  tell() {
    this.app.connection.send(encode(KIND.compare, { model: this.model || null }));
  }

  /** A new connection knows of no comparison. */
  connected() {
    if (this.model !== "" && !this.local) this.tell();
  }

  /** Another data set, or frame: its light is still to come. @param {any} scene */
  reset(scene) {
    const models = scene.light_fixed ? ["lambertian"] : scene.models;
    fill(this.select, [["", "nothing"], ...models.map((/** @type {string} */ name) => /** @type {[string, string]} */ ([name, MODEL_NAMES[name] ?? name]))]);
    if (!models.includes(this.model)) this.model = "";
    this.state = this.tiles = null;
    this.apply();
  }

  /** The light on the left has changed. */
  follow() {
    const { state } = this.app.light;
    if (this.local && this.model !== "" && state !== null) this.put({ ...state, model: this.model, key: `${state.key} ${this.model}` });
    else this.apply();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  take(head, arrays) {
    if (this.model === "") return; // it crossed the end of the comparison
    this.model = head.model; // of two pages that compare, the last to choose chooses for both
    this.put({ ...head, ...arrays });
  }

  /** Take on a light. @param {any} state */
  put(state) {
    const { scene, spheres, light, remote } = this.app;
    this.state = state;
    if (state.model === "lambertian" || remote.active) this.tiles = null;
    else {
      this.tiles ??= new TileStore(spheres.shown.count, scene.texels, ATLAS_BYTES, PARTICLES_WIDTH);
      this.tiles.setLight(state.key, state.decoding);
    }
    this.requests.again();
    this.apply();
    light.ask();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeTiles(head, arrays) {
    const { light, drawing } = this.app;
    light.confirm("beside");
    if (this.tiles === null || head.key !== this.state?.key) return;
    if (this.tiles.put(head.key, arrays.ids, arrays.codes, (id) => light.sight.isVisible(id), arrays.estimate)) drawing.lightChanged();
  }

  /** Whether the right shows another light than the left. */
  get differs() {
    return this.state !== null && this.state.key !== this.app.light.state?.key;
  }

  /** Whether there is to be a right side; its light may still be on its way. */
  get wanted() {
    return this.model !== "" && (this.state === null || this.differs);
  }

  /** Somebody else draws now. */
  switched() {
    if (this.state !== null) this.put(this.state);
    else this.apply();
  }

  /** Whether it has to ask for textures. */
  get asks() {
    return this.differs && this.tiles !== null;
  }

  /** Bring renderer and page in line: a second set, where there is something to tell apart. */
  apply() {
    const { drawing, scene, light, remote } = this.app;
    const { sets, gl } = drawing.renderer;
    if (!this.wanted) remote.endBeside();
    if (!this.differs || remote.active) {
      for (const set of sets.splice(1)) set.delete();
    } else {
      if (sets.length < 2) sets.push(new LightSet(gl));
      const [, set] = sets, { state, tiles } = this;
      if (tiles && set.tiles !== tiles) drawing.guard(() => set.setTiles(tiles, new CoarseStore(0, PARTICLES_WIDTH), scene));
      Object.assign(set, { lights: state, textured: tiles !== null, white: state.white, coarseScale: state.decoding[255] });
    }
    drawing.lightChanged();
    this.select.value = this.model;
    const left = light.state?.model ?? "";
    this.divider.show(this.model !== "", MODEL_NAMES[left] ?? left, MODEL_NAMES[this.model] ?? this.model);
  }

  /** What is visible is gathered anew. */
  look() {
    this.requests = new Requests(this.app.light.sight);
  }

  /** After a lost context: hand everything to a new renderer. */
  restore() {
    this.splitAt(this.divider.split);
    this.apply();
  }

  /** @param {number} split where the right side begins, as a fraction of the width */
  splitAt(split) {
    const { drawing } = this.app;
    drawing.renderer.split = split;
    drawing.film.lightChanged(true);
    drawing.schedule();
  }

  /** How far the right side is; null while there is none. */
  counts() {
    if (this.state === null) return null;
    const { light, remote } = this.app;
    if (remote.active && this.differs) return { model: this.state.model, key: this.state.key, ready: remote.right.shown?.ready ?? 0 };
    if (!this.differs) return { model: this.state.model, key: this.state.key, ready: light.counts().ready };
    const ready = this.tiles === null ? light.sight.count : light.sight.litCount(this.tiles, null).ready;
    return { model: this.state.model, key: this.state.key, ready };
  }
}
