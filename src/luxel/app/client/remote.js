// Pictures that the server draws: asks for what is to be seen, and shows what comes.

import { grading } from "./colors.js";
import { KIND, encode } from "./protocol.js";
import { viewJson } from "./views.js";

/** @typedef {import("./app.js").App} App */

const REST_MS = 180; // after the last change
const SIDE_MAX = 8192; // that the server draws

/** Factors on the background at the top and at the bottom, as the renderer here has them. @param {string} background */
function factors(background) {
  const { top, bottom, base } = grading(background);
  const k = base.indexOf(Math.max(...base));
  return base[k] > 0 ? [top[k] / base[k], bottom[k] / base[k]] : [1, 1];
}

/** What the server has sent of one light. */
class Side {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    /** The message of what is shown. @type {any} */
    this.shown = null;
    /** That of the picture itself. @type {any} */
    this.picture = null;
  }

  /** Nothing has been sent, or it is of no use any more. */
  forget() {
    this.shown = this.picture = null;
  }

  /** @param {any} head @param {ImageBitmap | null} bitmap null where the picture is still the last one */
  take(head, bitmap) {
    if (bitmap !== null) {
      this.draw(bitmap);
      this.picture = head;
    }
    this.shown = { ...head, lossless: this.picture?.lossless ?? false };
  }

  /** @param {ImageBitmap} bitmap */
  draw(bitmap) {
    const { canvas } = this;
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) Object.assign(canvas, { width: bitmap.width, height: bitmap.height });
    canvas.getContext("2d", { alpha: false })?.drawImage(bitmap, 0, 0);
    bitmap.close();
    canvas.hidden = false;
  }
}

export class Remote {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** Whether the server draws. */
    this.active = false;
    this.left = new Side(app.element("remote"));
    /** The light that is compared with, right of the divider. */
    this.right = new Side(app.element("remote-right"));
    this.wish = ""; // sent last
    this.sent = 0; // wishes
    this.timer = 0;
    this.frames = 0;
    this.restMs = REST_MS;
    /** Done when all messages so far are: pictures take a while to unpack, and must not overtake each other. */
    this.taken = Promise.resolve();
    const { signal } = app.closing;
    app.element("drawn-by").addEventListener("change", () => this.choose(app.element("drawn-by").value === "server"));
    document.addEventListener("visibilitychange", () => this.visibilityChanged(), { signal });
    signal.addEventListener("abort", () => clearTimeout(this.timer));
  }

  get shown() {
    return this.left.shown;
  }

  get canvas() {
    return this.left.canvas;
  }

  /** Who shall draw, as a hello says it; null before anybody has said so. */
  get by() {
    if (this.app.drawing.trouble !== null) return "server";
    return this.app.scene === null ? null : this.active ? "server" : "browser";
  }

  /** A new connection: it has been asked for nothing. */
  connected() {
    this.wish = "";
    this.forget();
  }

  forget() {
    this.left.forget();
    this.right.forget();
  }

  /** Another data set. @param {any} scene */
  reset(scene) {
    const { app, app: { drawing: { trouble } } } = this;
    if (trouble !== null && app.scene === null) {
      app.notices.trouble("drawing", `The server draws: ${trouble}.`, true);
    }
    this.set(Boolean(scene.streamed));
    this.wish = "";
    app.element("drawn-by").disabled = trouble !== null;
    app.element("drawn-by-row").hidden = !app.connection.live;
  }

  /** The user has said who draws. @param {boolean} server */
  choose(server) {
    const { app } = this;
    app.connection.send(encode(KIND.drawBy, { by: server ? "server" : "browser" }));
    if (app.scene === null) return;
    this.wish = "";
    this.set(server);
    app.beside.switched();
    if (!server && !app.scene.streamed) {
      app.coloring.forgetRanges(); // those came without values
      app.light.requests.again();
      app.drawing.film.restart();
    }
    app.notices.show();
    app.drawing.schedule();
  }

  /** @param {boolean} active */
  set(active) {
    // Where particles come part by part, they have other numbers here than there.
    if (active !== this.active && this.app.scene?.first) this.app.pick.set(-1);
    this.active = active;
    if (!active) clearTimeout(this.timer);
    if (!active) this.forget();
    for (const side of [this.left, this.right]) side.canvas.hidden = side.picture === null;
    this.app.element("drawn-by").value = active ? "server" : "browser";
  }

  /** Ask for what is to be seen now, if it is not what was asked for last. */
  step() {
    const { app } = this;
    if (!this.active || app.viewpoint.camera === null || !app.connection.connected || document.hidden) return;
    const wish = this.wanted();
    const text = JSON.stringify(wish);
    if (text === this.wish) return;
    const moving = this.wish !== "";
    this.wish = text;
    clearTimeout(this.timer);
    this.send(wish, moving);
    if (moving) this.timer = setTimeout(() => this.send(wish, false), this.restMs);
  }

  /** Whether what is shown answers the latest wish, under the present light. */
  get current() {
    const { app: { light, beside, viewpoint } } = this;
    const answers = (/** @type {Side} */ { shown }, /** @type {string | undefined} */ key) => shown !== null && shown.wish === this.sent && shown.key === key;
    // Baked light is compared with what has no textures, and the same key.
    return viewpoint.camera !== null && answers(this.left, light.state?.key) && JSON.stringify(this.wanted()) === this.wish
      && (!beside.wanted || answers(this.right, (beside.local ? light : beside).state?.key));
  }

  /** What is to be seen. */
  wanted() {
    const { panel, viewpoint, scene, drawing, beside } = this.app;
    const [width, height] = [drawing.canvas.width, drawing.canvas.height].map((side) => Math.min(side, SIDE_MAX));
    return { view: viewJson(panel.settings, viewpoint.camera, scene), width, height, grading: factors(panel.settings.background), beside: beside.wanted };
  }

  /** @param {object} wish @param {boolean} moving */
  send(wish, moving) {
    if (this.active) this.app.connection.send(encode(KIND.stream, { ...wish, moving, wish: ++this.sent }));
  }

  visibilityChanged() {
    if (!this.active) return;
    clearTimeout(this.timer);
    this.wish = ""; // so that it is asked for again
    if (document.hidden) this.app.connection.send(encode(KIND.stopStream, {}));
    else this.app.drawing.schedule();
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  take(head, arrays) {
    this.taken = this.taken.then(() => this.show(head, arrays)).catch((error) => {
      this.app.notices.trouble("graphics", `A picture from the server cannot be shown: ${error}`);
      this.app.report(`picture ${head.frame}: ${error}`);
    });
  }

  /** @param {any} head @param {Record<string, any>} arrays */
  async show(head, arrays) {
    if (!this.active) return;
    const type = head.lossless ? "image/png" : "image/jpeg";
    const bitmap = arrays.image.length ? await createImageBitmap(new Blob([arrays.image], { type }), { colorSpaceConversion: "none" }) : null;
    this.app.connection.send(encode(KIND.confirmFrame, { frame: head.frame, beside: head.beside }));
    if (!this.active || (head.beside && !this.app.beside.wanted)) return bitmap?.close();
    (head.beside ? this.right : this.left).take(head, bitmap);
    if (!head.beside) this.frames++;
    if (head.ready) this.app.notices.trouble("notice", null);
    this.app.notices.tick();
    if (head.final) this.app.notices.show();
    this.app.player.tick();
    this.app.study.tick();
  }

  /** The comparison has ended. */
  endBeside() {
    this.right.forget();
    this.right.canvas.hidden = true;
  }

  /** What the picture shows. */
  get counts() {
    const { visible = 0, ready = 0, coarse = 0, stale = 0 } = this.shown ?? {};
    return { visible, ready, estimates: 0, coarse, stale };
  }

  /** Ask which particle is at a point of the picture. @param {number} x fraction from the left @param {number} y from the top */
  pickAt(x, y) {
    const { view, width, height } = this.wanted();
    const [inX, inY] = [x, y].map((at) => Math.max(0, Math.min(1, at)));
    this.app.connection.send(encode(KIND.pickAt, { view, width, height, x: inX, y: inY }));
  }

  /** @param {any} head */
  takePicked(head) {
    if (!this.active || head.epoch !== this.app.scene?.epoch) return;
    this.app.pick.set(head.id, head.id < 0 ? null : { centre: head.center, radius: head.radius });
  }
}
