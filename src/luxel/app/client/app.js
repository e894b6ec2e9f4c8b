// The app: wires connection, data, picture and controls together, inside one element of whatever page it is in.

import * as cameras from "./camera.js";
import { CoarseStore } from "./coarse.js";
import { BakedStore } from "./codecs.js";
import { RGB, drawColorbar, grading, isCategorical, normalised, packed, rgb, toLinear } from "./colors.js";
import { Controls } from "./controls.js";
import { Film } from "./film.js";
import { debounced, download, finder } from "./dom.js";
import { Shown } from "./hiding.js";
import { Overlay } from "./overlay.js";
import { Panel } from "./panel.js";
import { Pick } from "./pick.js";
import { KIND, decode, encode } from "./protocol.js";
import { PARTICLES_WIDTH, Renderer } from "./renderer.js";
import { Sight } from "./sight.js";
import { TileStore } from "./tiles.js";
import { cameraFromFile, settingsOf, viewJson } from "./views.js";

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vec} Vec */
/** @typedef {import("./colors.js").Scalar} Scalar */

const ATLAS_BYTES = 64 << 20;
const PIXELS_MAX = 4_000_000;
const ASK_MS = 200;
const LIGHT_DELAY_MS = 120; // after the last movement of a slider

/**
 * What carries the bytes of messages: a socket, a notebook's comm, or a file that holds all there is to say.
 * @typedef {object} Transport
 * @property {() => void} open called once, when the app listens
 * @property {() => void} close no calls come after it
 * @property {(message: ArrayBuffer) => void} send dropped while there is no connection
 * @property {boolean} connected
 * @property {((message: ArrayBuffer) => void) | null} onmessage
 * @property {(() => void) | null} onopen a connection is made, perhaps anew: nothing that was said before counts any more
 * @property {((trouble: string | null, mild?: boolean) => void) | null} ontrouble what is wrong, in words; null when it no longer is
 */

export class App {
  /**
   * @param {HTMLElement} root holds the markup of index.html
   * @param {Transport} connection
   * @param {{titled?: (title: string) => void}} [host] the page around
   */
  constructor(root, connection, host = {}) {
    this.root = root;
    this.element = finder(root);
    this.stage = this.element("stage");
    /** @type {HTMLCanvasElement} */
    this.canvas = this.element("view");
    this.connection = connection;
    this.closing = new AbortController();
    /** @type {any} */
    this.scene = null;
    /** @type {any} */
    this.light = null;
    /** @type {any} */
    this.status = null;
    /** @type {Camera | null} */
    this.camera = null;
    this.shown = new Shown(0, PARTICLES_WIDTH);
    /** What is hidden from light too: as the server has it, or ahead of it while a slider moves. @type {import("./hiding.js").Condition[]} */
    this.opened = [];
    this.sendOpened = debounced(() => this.sendLight({ hide: this.opened }), LIGHT_DELAY_MS);
    /** @type {Map<string, Scalar>} */
    this.scalars = new Map();
    /** @type {Map<string, Uint8Array>} */
    this.luts = new Map();
    this.asked = new Set();
    this.tiles = new TileStore(0, 16, 0, PARTICLES_WIDTH);
    this.coarse = new CoarseStore(0, PARTICLES_WIDTH);
    /** Textures that need no server, once they have come. @type {BakedStore | null} */
    this.baked = null;
    this.sight = new Sight(0);
    this.askTimer = 0;
    this.confirmed = { batches: 0, coarse: 0, parts: 0 };
    this.tilesReceived = 0;
    this.coloring = "";
    this.scheduled = false;
    this.statusAt = 0;
    this.framesSeen = 0;
    this.fps = 0;
    /** @type {Map<string, string>} what the banner says, by cause */
    this.troubles = new Map();
    this.panel = new Panel(root, {
      color: () => this.colorChanged(),
      tone: () => this.toneChanged(),
      light: (change) => this.sendLight(change),
      frame: (frame) => this.connection.send(encode(KIND.setFrame, { frame })),
      fit: () => this.fit(),
      axis: (axis, negative) => this.axisView(axis, negative),
      projection: () => this.changeCamera(cameras.toggleProjection),
      save: () => this.save(),
      layout: () => this.resize(),
      titled: (title) => host.titled?.(title),
      up: () => this.upChanged(),
      radius: (scale) => this.scaleRadii(scale),
      hide: ({ keeps, opens }) => this.hideChanged(keeps, opens),
      towardsMe: () => [...(this.camera ? cameras.unit(cameras.sub(this.camera.eye, this.camera.target)) : [0, 0, 1])],
      rangeOf: (name) => this.scalars.get(name)?.range ?? null,
      saveView: () => this.saveView(),
      loadView: (text) => this.loadView(text),
    });
    this.overlay = new Overlay(/** @type {any} */ (this.element("overlay")));
    this.pick = new Pick(root, {
      inspect: (id) => this.connection.send(encode(KIND.inspect, { id })),
      shown: () => this.shown,
      redraw: () => this.drawOverlay(),
    });
    this.renderer = this.makeRenderer();
    this.film = this.makeFilm();
    connection.onmessage = (message) => this.receive(decode(message));
    connection.ontrouble = (trouble, mild = false) => {
      this.trouble("connection", mild ? null : trouble);
      this.trouble("waiting", mild ? trouble : null);
    };
    connection.onopen = () => {
      this.confirmed = { batches: 0, coarse: 0, parts: 0 };
      this.connection.send(encode(KIND.hello, { renderer: this.renderer.name.slice(0, 400) }));
    };
    new Controls(this.canvas, {
      get: () => this.camera,
      set: (camera) => this.setCamera(camera),
      frame: () => this.fit(),
      axis: (axis, negative) => this.axisView(axis, negative),
      click: (x, y) => this.pickAt(x, y),
      escape: () => this.pick.set(-1),
    });
    this.canvas.addEventListener("webglcontextlost", (event) => {
      if (this.closing.signal.aborted) return;
      event.preventDefault(); // or it would never come back
      this.trouble("graphics", "The graphics context was lost — waiting for the browser to restore it …");
      this.report("graphics context lost");
    });
    this.canvas.addEventListener("webglcontextrestored", () => this.restore());
    const { signal } = this.closing;
    const resizes = new ResizeObserver(() => this.resize());
    resizes.observe(this.stage);
    signal.addEventListener("abort", () => resizes.disconnect());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.drawBar(), { signal });
    this.resize();
    connection.open();
  }

  /** Give everything back; the root may be thrown away then. */
  close() {
    this.closing.abort();
    clearTimeout(this.askTimer);
    this.connection.onmessage = this.connection.onopen = this.connection.ontrouble = null;
    this.connection.close();
    // Browsers keep few graphics contexts, and collect those without owner late.
    this.renderer.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  makeRenderer() {
    return new Renderer(this.canvas);
  }

  makeFilm() {
    return new Film(this.renderer, (data, stride, epoch) => {
      this.sight.collect(data, stride, epoch);
      this.ask();
    }, () => this.sight.ids.subarray(0, this.sight.count));
  }

  // Messages ---------------------------------------------------------------------------------------------------------

  /** @param {import("./protocol.js").Message} message */
  receive({ kind, head, arrays }) {
    switch (kind) {
      case KIND.scene: return this.takeScene(head);
      case KIND.light: return this.takeLight(head, arrays);
      case KIND.geometry: return this.takeGeometry(head, arrays);
      case KIND.scalar: return this.takeScalar(head, arrays);
      case KIND.colormap:
        this.luts.set(head.name, arrays.lut);
        return this.colorChanged();
      case KIND.tiles: return this.takeTiles(head, arrays);
      case KIND.coarse: return this.takeCoarse(head, arrays);
      case KIND.codec: return this.takeCodec(head, arrays);
      case KIND.payload: return this.takePayload(head, arrays);
      case KIND.status:
        this.status = head;
        this.trouble("light", head.error ? `Light: ${head.error}` : null);
        if (head.ready || this.light?.model === "lambertian") this.trouble("notice", null);
        return this.showStatus();
      case KIND.error: return this.trouble("server", head.text, true);
      case KIND.view: return this.takeView(head.view);
      case KIND.particle: return head.epoch === this.scene?.epoch && this.pick.take(head);
    }
  }

  /** @param {any} head */
  takeScene(head) {
    const again = this.scene !== null && this.scene.title === head.title;
    this.scene = head;
    this.shown = new Shown(head.count, PARTICLES_WIDTH);
    this.shown.setScale(this.light?.lighting.radius_scale ?? 1);
    this.scalars.clear();
    this.asked.clear();
    this.coloring = "";
    const reach = Math.hypot(...head.bounds[0].map((/** @type {number} */ low, /** @type {number} */ k) => Math.max(-low, head.bounds[1][k])));
    this.guard(() => this.renderer.setScene(head.count, reach));
    this.tiles = new TileStore(head.count, head.texels, ATLAS_BYTES, PARTICLES_WIDTH);
    this.coarse = new CoarseStore(head.count, PARTICLES_WIDTH);
    this.baked = null;
    this.guard(() => this.renderer.sets[0].setTiles(this.tiles, this.coarse, head));
    this.sight = new Sight(head.count);
    if (this.pick.id >= 0) this.pick.set(again && this.pick.id < head.count ? this.pick.id : -1);
    this.panel.setScene(head, again);
    this.trouble("notice", head.notice || null);
    if (!again || this.camera === null) {
      this.setCamera(head.view.camera ? cameraFromFile(head.view.camera, head) : this.framed(this.firstDirection(), false));
    }
    this.applyHiding();
    this.film.restart();
    this.colorChanged();
    this.toneChanged();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeLight(head, arrays) {
    this.light = { ...head, ...arrays };
    this.lightRenderer();
    if (!this.sendOpened.pending()) {
      this.opened = head.lighting.hide;
      this.panel.hiding.take({ keeps: this.panel.settings.hide, opens: this.opened });
    }
    if (!this.panel.ahead("radius")) this.scaleRadii(head.lighting.radius_scale);
    this.applyHiding();
    this.tiles.setLight(head.key, arrays.decoding);
    this.coarse.setLight(head.key);
    this.panel.setLight(head);
    this.sight.askAgain();
    this.film.lightChanged();
    this.toneChanged();
    this.ask();
  }

  lightRenderer() {
    const { light } = this;
    Object.assign(this.renderer.sets[0], {
      lights: light, textured: light.model !== "lambertian", white: light.white, coarseScale: light.decoding[255],
    });
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeGeometry(head, arrays) {
    if (head.epoch !== this.scene?.epoch) return;
    this.shown.put(head.start, arrays.positions, arrays.radii);
    this.uploadSpheres();
    this.film.restart();
    this.schedule();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeScalar(head, arrays) {
    if (head.epoch !== this.scene?.epoch) return;
    const { labels } = this.scene.scalars.find((/** @type {any} */ each) => each.name === head.name) ?? { labels: null };
    this.scalars.set(head.name, { values: arrays.values, range: head.range, logRange: head.log_range, whole: head.whole, labels });
    this.panel.hiding.show();
    this.applyHiding();
    this.colorChanged();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeTiles(head, arrays) {
    this.confirm("batches");
    this.tilesReceived += arrays.ids.length;
    if (this.tiles.put(head.key, arrays.ids, arrays.codes, (id) => this.sight.isVisible(id), arrays.estimate)) {
      this.film.lightChanged();
      this.schedule();
    }
    this.trouble("notice", null); // whatever there was to wait for is over
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeCoarse(head, arrays) {
    this.confirm("coarse");
    if (this.coarse.put(head.key, arrays.ids, arrays.records)) {
      this.film.lightChanged();
      this.schedule();
    }
    this.trouble("notice", null);
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeCodec(head, arrays) {
    if (head.key !== this.light?.key) return;
    this.baked = new BakedStore({ ...head.description, mapping: this.scene.mapping, particles: head.particles, part: head.part, payload_bytes: head.payload_bytes }, arrays);
    this.guard(() => this.renderer.sets[0].setBaked(this.baked));
    this.film.lightChanged();
    this.sight.askAgain();
    this.schedule();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takePayload(head, arrays) {
    this.confirm("parts");
    if (head.key !== this.light?.key || this.baked === null) return;
    this.baked.put(head.start, arrays.records);
    this.film.lightChanged();
    this.trouble("notice", null);
    this.schedule();
  }

  /** Where the textures of the current light are. */
  get store() {
    return this.baked ?? this.tiles;
  }

  /** Make room for more messages of a kind. @param {"batches" | "coarse" | "parts"} which */
  confirm(which) {
    this.confirmed[which]++;
    this.connection.send(encode(KIND.confirm, this.confirmed));
  }

  /** @param {{model?: string, sky?: number, sun?: number[], up?: string, hide?: object[], radius_scale?: number}} change */
  sendLight(change) {
    this.connection.send(encode(KIND.setLight, change));
  }

  /** Tell the server what is visible and has no light yet. */
  ask() {
    clearTimeout(this.askTimer);
    if (this.light === null || this.light.model === "lambertian" || this.camera === null || this.baked?.complete) return;
    const ids = this.sight.request(this.store, performance.now());
    if (this.sight.waiting) this.askTimer = setTimeout(() => this.ask(), ASK_MS);
    if (ids !== null && ids.length) {
      this.connection.send(encode(KIND.sighted, { key: this.light.key, eye: this.camera.eye }, { ids: ids.slice() }));
    }
  }

  /** @param {string} text */
  report(text) {
    this.connection?.send(encode(KIND.report, { text: text.slice(0, 3900) }));
  }

  // Colours ----------------------------------------------------------------------------------------------------------

  colorChanged() {
    const s = this.panel.settings;
    const { look } = this.renderer;
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
    } else if (scalar && lut) {
      const wanted = JSON.stringify([this.scene.epoch, s.colorBy, s.colormap, s.range, s.log]);
      if (wanted !== this.coloring) {
        this.renderer.setValues(normalised(scalar, lut.length / 3, s.range, s.log));
        this.renderer.setLut(lut);
        this.coloring = wanted;
      }
      look.uniform = look.packed = false;
      this.panel.setShownRange(s.log ? scalar.logRange : scalar.range);
    }
    this.drawBar();
    this.film.lightChanged();
    this.schedule();
  }

  /** Show a vector's components as colours, once they are all here. @param {string} name */
  showOwnColors(name) {
    const names = ["x", "y", "z"].map((component) => `${name}.${component}`);
    const channels = names.flatMap((each) => this.scalars.get(each) ?? []);
    for (const each of names) if (!this.scalars.has(each)) this.askFor(KIND.scalarRequest, each);
    if (channels.length < 3) return;
    const wanted = JSON.stringify([this.scene.epoch, name, RGB]);
    if (wanted !== this.coloring) {
      this.renderer.setValues(packed(channels));
      this.coloring = wanted;
    }
    this.renderer.look.uniform = false;
    this.renderer.look.packed = true;
  }

  /** @param {number} kind @param {string} name */
  askFor(kind, name) {
    const key = `${kind} ${name}`;
    if (this.asked.has(key)) return;
    this.asked.add(key);
    this.connection.send(encode(kind, { name }));
  }

  drawBar() {
    const s = this.panel.settings;
    const scalar = s.colorBy === null ? undefined : this.scalars.get(s.colorBy);
    const lut = this.luts.get(s.colormap);
    if (s.colorBy === null || !scalar || !lut) return;
    const rows = lut.length / 3;
    const codes = isCategorical(scalar, rows, s.range, s.log);
    const labels = codes ? scalar.labels ?? Array.from({ length: Math.min(rows, 1 + Math.max(0, scalar.range[1])) }, (_, k) => String(k)) : null;
    drawColorbar(this.element("bar"), {
      lut, log: s.log, title: s.colorBy, labels,
      range: s.range ?? (s.log ? scalar.logRange : scalar.range),
      noData: scalar.values.some(Number.isNaN) ? s.noData : null,
    });
  }

  toneChanged() {
    const s = this.panel.settings;
    Object.assign(this.renderer.look, { exposure: s.exposure }, grading(s.background));
    this.drawBar();
    this.film.toneChanged();
    this.schedule();
  }

  /** Whether the server is still to be told of a change. */
  get pending() {
    return this.sendOpened.pending() || Object.values(this.panel.changes).some((change) => change.pending());
  }

  // What is shown ------------------------------------------------------------------------------------------------------

  /** @param {import("./hiding.js").Condition[]} keeps @param {import("./hiding.js").Condition[]} opens */
  hideChanged(keeps, opens) {
    this.panel.settings.hide = keeps;
    if (JSON.stringify(opens) !== JSON.stringify(this.opened)) {
      this.opened = opens;
      this.sendOpened();
    }
    this.applyHiding();
  }

  applyHiding() {
    if (this.scene === null) return;
    const { shown } = this;
    const changed = shown.hide([...this.panel.settings.hide, ...this.opened], this.scalars, this.scene);
    for (const name of shown.missing) this.askFor(KIND.scalarRequest, name);
    this.panel.hiding.showCount(shown.hiddenCount, shown.count);
    if (changed) this.uploadSpheres();
  }

  /** @param {number} scale of all radii */
  scaleRadii(scale) {
    if (this.shown.setScale(scale)) this.uploadSpheres();
  }

  /** The spheres have changed, and with them what is visible. */
  uploadSpheres() {
    this.shown.flush((start, part) => this.renderer.setSpheres(start, part));
    this.drawOverlay();
    if (this.camera !== null) this.film.setCamera(this.camera); // as after a move: coarse at first, then everything anew
    this.schedule();
  }

  upChanged() {
    if (this.camera === null || this.scene === null) return;
    this.camera = { ...this.camera, up: cameras.upFrame(this.panel.settings.up)[2] };
    this.setCamera(this.framed(this.firstDirection(), this.camera.height !== null));
    if (!this.scene.light_fixed) this.sendLight({ sun: this.panel.sun(), sky: this.panel.sky(), up: this.panel.settings.up });
  }

  /** All that makes this picture, as luxel.SavedView has it. */
  savedView() {
    const { scene, light, camera } = this;
    return {
      luxel_view: 1, frame: scene.frame, view: viewJson(this.panel.settings, camera, scene),
      light: scene.light_fixed ? null : { ...light.lighting, hide: this.opened, radius_scale: this.shown.scale },
    };
  }

  saveView() {
    if (this.scene === null || this.light === null) return;
    const text = `${JSON.stringify(this.savedView(), null, 2)}\n`;
    download(new Blob([text], { type: "application/json" }), `${this.scene.title.replace(/\.\w+$/, "")}.view.json`);
  }

  /** @param {string} text of a file */
  loadView(text) {
    let saved;
    try {
      saved = JSON.parse(text);
    } catch (error) {
      return this.trouble("server", `This is no view: ${error instanceof Error ? error.message : error}`, true);
    }
    if (typeof saved !== "object" || saved === null || Array.isArray(saved)) return this.trouble("server", "This is no view: it must be a JSON object", true);
    this.connection.send(encode(KIND.loadView, { saved }));
  }

  /** @param {any} view as of View.to_json() */
  takeView(view) {
    Object.assign(this.panel.settings, settingsOf(view));
    this.panel.refresh();
    this.panel.hiding.take({ keeps: view.hide, opens: this.opened });
    if (view.camera) this.setCamera(cameraFromFile(view.camera, this.scene));
    this.applyHiding();
    this.colorChanged();
    this.toneChanged();
  }

  // Camera -----------------------------------------------------------------------------------------------------------

  get aspect() {
    return this.canvas.width / this.canvas.height;
  }

  /** @returns {Vec} from the target to the eye: that of Camera.framing */
  firstDirection() {
    return cameras.direction(cameras.upFrame(this.panel.settings.up), -Math.PI / 3, (25 * Math.PI) / 180);
  }

  /** @param {Vec} towards @param {boolean} orthographic @returns {Camera} */
  framed(towards, orthographic) {
    const up = this.camera?.up ?? cameras.upFrame(this.panel.settings.up)[2];
    return cameras.framing(this.scene.bounds, towards, { up, fov: this.camera?.fov ?? 30, aspect: this.aspect, orthographic });
  }

  fit() {
    if (this.camera === null) return;
    const towards = cameras.unit(cameras.sub(this.camera.eye, this.camera.target));
    this.setCamera(this.framed(towards, this.camera.height !== null));
  }

  /** @param {string} axis @param {boolean} negative */
  axisView(axis, negative) {
    if (this.camera === null) return;
    const k = "xyz".indexOf(axis);
    const sign = negative ? -1 : 1;
    const frame = cameras.upFrame(this.panel.settings.up);
    /** @type {Vec} */
    let towards = [0, 0, 0];
    towards[k] = sign;
    const up = frame[2];
    if (Math.abs(cameras.dot(towards, up)) > 0.5) {
      // From straight above there is no up; a hair's breadth off, the map's usual way round comes out.
      towards = cameras.direction(frame, -Math.PI / 2, sign * (89.99 * Math.PI) / 180);
    }
    this.camera = { ...this.camera, up };
    this.setCamera(this.framed(towards, this.camera.height !== null));
  }

  /** @param {(camera: Camera) => Camera} change */
  changeCamera(change) {
    if (this.camera !== null) this.setCamera(change(this.camera));
  }

  /** @param {Camera} camera */
  setCamera(camera) {
    this.camera = camera;
    this.element("orthographic").checked = camera.height !== null;
    this.film.setCamera(camera);
    this.drawOverlay();
    this.schedule();
  }

  // Drawing ----------------------------------------------------------------------------------------------------------

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
    this.drawBar();
    this.drawOverlay();
    this.schedule();
  }

  schedule() {
    if (this.scheduled) return;
    this.scheduled = true;
    requestAnimationFrame(() => {
      this.scheduled = false;
      if (this.closing.signal.aborted) return;
      this.guard(() => this.step());
    });
  }

  step() {
    if (this.renderer.gl.isContextLost()) return;
    this.upload();
    const more = this.film.step();
    const now = performance.now();
    if (now - this.statusAt > 500) this.showStatus();
    if (more) this.schedule();
  }

  upload() {
    for (const set of this.renderer.sets) set.upload();
  }

  /** Run what may fail for lack of graphics, and say so. @param {() => void} action */
  guard(action) {
    try {
      action();
    } catch (error) {
      const text = error instanceof Error ? error.message : String(error);
      this.trouble("graphics", text);
      this.report(text);
      throw error;
    }
  }

  /** After a lost context everything on the graphics processor is gone; memory has it all. */
  restore() {
    this.guard(() => {
      this.renderer = this.makeRenderer();
      this.film = this.makeFilm();
      this.resize();
      if (this.scene !== null) {
        this.renderer.setScene(this.scene.count, 4);
        this.shown.dirty.all();
        this.shown.flush((start, part) => this.renderer.setSpheres(start, part));
        this.renderer.sets[0].setTiles(this.tiles, this.coarse, this.scene);
        this.renderer.sets[0].setBaked(this.baked);
      }
      if (this.light !== null) {
        this.lightRenderer();
      }
      this.coloring = "";
      if (this.camera !== null) this.setCamera(this.camera);
      this.sight = new Sight(this.scene?.count ?? 0);
      this.colorChanged();
      this.toneChanged();
    });
    this.trouble("graphics", null);
  }

  // Words ------------------------------------------------------------------------------------------------------------

  showStatus() {
    const now = performance.now();
    if (now - this.statusAt > 400) {
      const frames = this.renderer.frameCount - this.framesSeen;
      this.fps = frames > 1 ? (frames * 1000) / (now - this.statusAt) : 0;
      this.framesSeen = this.renderer.frameCount;
      this.statusAt = now;
    }
    if (this.scene === null) return;
    const { visible, ready, estimates, coarse, stale } = this.counts();
    const n = (/** @type {number} */ x) => x.toLocaleString("en");
    const parts = [`${n(visible)} visible`];
    if (this.light?.model === "lambertian") {
      parts.push("no global light");
    } else if (this.baked) {
      parts.push(ready >= visible ? "baked light" : `${n(ready)} with baked light`);
    } else {
      parts.push(ready >= visible ? "all lit" : `${n(ready)} lit`);
      if (estimates) parts.push(`${n(estimates)} estimates`);
      if (coarse) parts.push(`${n(coarse)} in first light`);
      if (stale) parts.push(`${n(stale)} in the light before`);
      if (this.status?.queued) parts.push(`${n(this.status.queued + this.status.baking)} queued`);
      if (ready < visible && this.status?.textures_per_s >= 1) parts.push(`${n(Math.round(this.status.textures_per_s))} textures/s`);
      if (this.store.dropped) parts.push("texture memory full");
    }
    if (this.fps >= 0.5) parts.push(`${this.fps < 10 ? this.fps.toFixed(1) : Math.round(this.fps)} fps`);
    this.element("counts").textContent = parts.join("  ·  ");
    /** @type {HTMLProgressElement} */
    const progress = this.element("progress");
    progress.value = visible ? ready / visible : 0;
    progress.parentElement?.classList.toggle("stale", stale > 0);
    progress.hidden = this.light?.model === "lambertian" || ready >= visible;
  }

  counts() {
    return { visible: this.sight.count, ...this.sight.litCount(this.store, this.coarse) };
  }

  /** Say what is wrong, or that it no longer is. @param {string} cause @param {string | null} text @param {boolean} [passing] goes away by itself */
  trouble(cause, text, passing = false) {
    if (text === null) this.troubles.delete(cause);
    else this.troubles.set(cause, text);
    if (passing && text !== null) {
      setTimeout(() => {
        if (this.troubles.get(cause) === text) this.trouble(cause, null);
      }, 8000);
    }
    const banner = this.element("banner");
    banner.textContent = [...this.troubles.values()].join("\n");
    banner.hidden = this.troubles.size === 0;
    banner.classList.toggle("mild", [...this.troubles.keys()].every((key) => key === "notice" || key === "waiting"));
  }

  /** Tell about the particle at a point of the picture. @param {number} x fraction from the left @param {number} y from the top */
  pickAt(x, y) {
    if (this.camera !== null && this.scene !== null) this.pick.set(this.renderer.idAt(this.camera, x, 1 - y));
  }

  /** Axes, scale bar and what was picked. */
  drawOverlay() {
    if (this.camera === null || this.scene === null) return;
    const at = this.overlay.draw(this.camera, this.scene, this.pick.sphere);
    this.pick.place(at, this.stage.clientWidth, this.stage.clientHeight);
  }

  save() {
    if (this.film.shown === null) return;
    const { shown } = this.film;
    const { width, height } = this.canvas;
    this.renderer.present(shown.pair, shown.count, { width: Math.floor(width * shown.scale), height: Math.floor(height * shown.scale), epoch: 0 });
    this.canvas.toBlob((blob) => {
      if (blob === null) return;
      download(blob, `${this.scene?.title ?? "luxel"}.png`);
    });
  }
}
