// Where the picture is taken from: framing, views along axes, and the axis that points up.

import * as cameras from "./camera.js";

/** @typedef {import("./app.js").App} App */
/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vec} Vec */

export class Viewpoint {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** In normalised units. @type {Camera | null} */
    this.camera = null;
  }

  get up() {
    return this.app.panel.settings.up;
  }

  /** @returns {Vec} from the target to the eye: that of Camera.framing */
  firstDirection() {
    return cameras.direction(cameras.upFrame(this.up), -Math.PI / 3, (25 * Math.PI) / 180);
  }

  /** From the target to the eye, a unit vector. @returns {Vec} */
  towardsMe() {
    return this.camera ? cameras.unit(cameras.sub(this.camera.eye, this.camera.target)) : [0, 0, 1];
  }

  /** @param {Vec} towards @param {boolean} orthographic @returns {Camera} */
  framed(towards, orthographic) {
    const { scene, drawing } = this.app;
    const up = this.camera?.up ?? cameras.upFrame(this.up)[2];
    return cameras.framing(scene.bounds, towards, { up, fov: this.camera?.fov ?? 30, aspect: drawing.aspect, orthographic });
  }

  fit() {
    if (this.camera !== null) this.set(this.framed(this.towardsMe(), this.camera.height !== null));
  }

  /** @param {string} axis @param {boolean} negative */
  axisView(axis, negative) {
    if (this.camera === null) return;
    const k = "xyz".indexOf(axis);
    const sign = negative ? -1 : 1;
    const frame = cameras.upFrame(this.up);
    /** @type {Vec} */
    let towards = [0, 0, 0];
    towards[k] = sign;
    const up = frame[2];
    if (Math.abs(cameras.dot(towards, up)) > 0.5) {
      // From straight above there is no up; a hair's breadth off, the map's usual way round comes out.
      towards = cameras.direction(frame, -Math.PI / 2, sign * (89.99 * Math.PI) / 180);
    }
    this.camera = { ...this.camera, up };
    this.set(this.framed(towards, this.camera.height !== null));
  }

  /** Another axis points up. */
  upChanged() {
    const { scene, light, panel } = this.app;
    if (this.camera === null || scene === null) return;
    this.camera = { ...this.camera, up: cameras.upFrame(this.up)[2] };
    this.set(this.framed(this.firstDirection(), this.camera.height !== null));
    if (!scene.light_fixed) light.send({ sun: panel.sun(), sky: panel.sky(), up: this.up });
  }

  toggleProjection() {
    if (this.camera !== null) this.set(cameras.toggleProjection(this.camera));
  }

  /** @param {Camera} camera */
  set(camera) {
    const { drawing } = this.app;
    this.camera = camera;
    this.app.element("orthographic").checked = camera.height !== null;
    drawing.film.setCamera(camera);
    drawing.drawOverlay();
    drawing.schedule();
  }
}
