// The light on the particles: what the server says it is, the textures that come of it, and what to ask the server for.

import { CoarseStore } from "./coarse.js";
import { BakedStore } from "./codecs.js";
import { KIND, encode } from "./protocol.js";
import { PARTICLES_WIDTH } from "./renderer.js";
import { Requests, Sight } from "./sight.js";
import { ATLAS_BYTES, TileStore } from "./tiles.js";

/** @typedef {import("./app.js").App} App */

const ASK_MS = 200;

export class Illumination {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** The light message. @type {any} */
    this.state = null;
    this.tiles = new TileStore(0, 16, 0, PARTICLES_WIDTH);
    this.coarse = new CoarseStore(0, PARTICLES_WIDTH);
    /** Textures that need no server, once they have come. @type {BakedStore | null} */
    this.baked = null;
    this.sight = new Sight(0);
    this.requests = new Requests(this.sight);
    this.timer = 0;
    this.confirmed = { batches: 0, coarse: 0, parts: 0, beside: 0 };
    this.received = 0;
  }

  get set() {
    return this.app.drawing.renderer.sets[0];
  }

  /** Where the textures of the current light are. */
  get store() {
    return this.baked ?? this.tiles;
  }

  /** Another data set. @param {any} scene */
  reset(scene) {
    this.tiles = new TileStore(scene.count, scene.texels, ATLAS_BYTES, PARTICLES_WIDTH);
    this.coarse = new CoarseStore(scene.count, PARTICLES_WIDTH);
    this.baked = null;
    this.app.drawing.guard(() => this.set.setTiles(this.tiles, this.coarse, scene));
    this.look(scene.count);
  }

  /** Begin to gather anew what is visible. @param {number} count particles */
  look(count) {
    this.sight = new Sight(count);
    this.requests = new Requests(this.sight);
    this.app.beside.look();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  take(head, arrays) {
    const { app } = this;
    this.state = { ...head, ...arrays };
    this.apply();
    app.spheres.takeLight(head.lighting);
    this.tiles.setLight(head.key, arrays.decoding);
    this.coarse.setLight(head.key);
    app.panel.setLight(head);
    app.beside.follow();
    app.study.offer();
    this.requests.again();
    app.drawing.film.lightChanged();
    app.coloring.toneChanged();
    this.ask();
  }

  /** Hand the light to the renderer. */
  apply() {
    const { state } = this;
    Object.assign(this.set, {
      lights: state, textured: state.model !== "lambertian", white: state.white, coarseScale: state.decoding[255],
    });
  }

  /** Hand everything to a new renderer. */
  restore() {
    const { scene } = this.app;
    if (scene !== null) {
      this.set.setTiles(this.tiles, this.coarse, scene);
      this.set.setBaked(this.baked);
    }
    if (this.state !== null) this.apply();
    this.look(scene?.count ?? 0);
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeTiles(head, arrays) {
    if (head.beside) return this.app.beside.takeTiles(head, arrays);
    this.confirm("batches");
    this.received += arrays.ids.length;
    if (this.tiles.put(head.key, arrays.ids, arrays.codes, (id) => this.sight.isVisible(id), arrays.estimate)) this.app.drawing.lightChanged();
    this.dawned();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeCoarse(head, arrays) {
    this.confirm("coarse");
    if (this.coarse.put(head.key, arrays.ids, arrays.records)) this.app.drawing.lightChanged();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takeCodec(head, arrays) {
    if (head.key !== this.state?.key) return;
    const { mapping } = this.app.scene;
    const particles = Math.min(head.particles, this.app.spheres.shown.count); // there may be room for a part of them only
    this.baked = new BakedStore({ ...head.description, mapping, particles, part: head.part, payload_bytes: head.payload_bytes }, arrays);
    this.app.drawing.guard(() => this.set.setBaked(this.baked));
    this.requests.again();
    this.app.drawing.lightChanged();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  takePayload(head, arrays) {
    this.confirm("parts");
    if (head.key !== this.state?.key || this.baked === null) return;
    const { count, description: { payload_bytes: size } } = this.baked;
    if (head.start >= count) return;
    this.baked.put(head.start, arrays.records.subarray(0, size * (count - head.start)));
    this.app.drawing.lightChanged();
    this.dawned();
  }

  /** Whatever there was to wait for is over. */
  dawned() {
    this.app.notices.trouble("notice", null);
  }

  /** Make room for more messages of a kind. @param {"batches" | "coarse" | "parts" | "beside"} which */
  confirm(which) {
    this.confirmed[which]++;
    this.app.connection.send(encode(KIND.confirm, this.confirmed));
  }

  /** A new connection: it has confirmed nothing. */
  connected() {
    this.confirmed = { batches: 0, coarse: 0, parts: 0, beside: 0 };
  }

  /** Change the light. @param {{model?: string, sky?: number, sun?: number[], up?: string, hide?: object[], radius_scale?: number}} change */
  send(change) {
    this.app.connection.send(encode(KIND.setLight, change));
  }

  /** Whether no light is to be asked for. */
  get lit() {
    return this.state === null || this.state.model === "lambertian" || this.baked?.complete;
  }

  /** Whether textures are on their way of what has none. */
  get awaited() {
    return !this.lit && this.requests.waiting && this.sight.litCount(this.store, null).ready < this.sight.count;
  }

  /** Tell the server what is visible and has no light yet. */
  ask() {
    clearTimeout(this.timer);
    const { state, lit, app: { beside, remote } } = this;
    if (remote.active) return;
    const waiting = !lit && this.askFor(state.key, this.requests, this.store);
    const { tiles } = beside;
    const waitingBeside = tiles !== null && beside.asks && this.askFor(beside.state.key, beside.requests, tiles);
    if (waiting || waitingBeside) this.timer = setTimeout(() => this.ask(), ASK_MS);
  }

  /** @param {string} key @param {Requests} requests @param {import("./sight.js").Store} store @returns {boolean} whether there is more to ask for */
  askFor(key, requests, store) {
    const { viewpoint: { camera }, connection } = this.app;
    if (camera === null) return false;
    const ids = requests.next(store, performance.now());
    if (ids?.length) connection.send(encode(KIND.sighted, { key, eye: camera.eye }, { ids: ids.slice() }));
    return requests.waiting;
  }

  counts() {
    if (this.app.remote.active) return this.app.remote.counts;
    return { visible: this.sight.count, ...this.sight.litCount(this.store, this.coarse) };
  }

  close() {
    clearTimeout(this.timer);
  }
}
