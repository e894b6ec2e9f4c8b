// Plays the time steps of a series, one after the other: never faster than they are drawn.

/** @typedef {import("./app.js").App} App */

export class Player {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.playing = false;
    /** The step that was asked for last. */
    this.awaited = -1;
    this.begunAt = 0;
    this.timer = 0;
    this.button = app.element("play");
    this.button.addEventListener("click", () => this.toggle());
    const slider = app.element("frame");
    for (const touch of ["input", "pointerdown"]) slider.addEventListener(touch, () => this.stop());
  }

  toggle() {
    if (this.playing) this.stop();
    else this.start();
  }

  start() {
    const { scene } = this.app;
    if (scene === null || scene.frame_count < 2) return;
    this.playing = true;
    this.awaited = scene.frame;
    this.begunAt = -Infinity;
    this.show();
    this.tick();
  }

  stop() {
    this.playing = false;
    clearTimeout(this.timer);
    this.timer = 0;
    this.show();
  }

  /** Steps a second that the user wants. */
  get rate() {
    return Number(this.app.element("rate").value);
  }

  /** Whether the step that was asked for last is on the screen. */
  get drawn() {
    const { scene, spheres, coloring, drawing, remote } = this.app;
    if (remote.active) return scene.frame === this.awaited && remote.current;
    return scene.frame === this.awaited && spheres.complete && !coloring.waiting && drawing.film.shown !== null;
  }

  /** Something was drawn: perhaps it is time for the next step. */
  tick() {
    if (!this.playing || this.timer || !this.drawn) return;
    const wait = this.begunAt + 1000 / this.rate - performance.now();
    this.timer = window.setTimeout(() => this.next(), Math.max(0, wait));
  }

  next() {
    this.timer = 0;
    this.begunAt = performance.now();
    this.ask(this.app.scene.frame + 1);
  }

  /** Show the step after or before this one. @param {1 | -1} by */
  step(by) {
    const { scene } = this.app;
    this.stop();
    if (scene !== null && scene.frame_count > 1) this.ask(scene.frame + by);
  }

  /** @param {number} frame any number: after the last step comes the first */
  ask(frame) {
    const { scene } = this.app;
    this.awaited = (frame + scene.frame_count) % scene.frame_count;
    this.app.askForFrame(this.awaited);
  }

  /** A step has come: the one that was asked for, or what another page or a new connection shows. @param {number} frame */
  take(frame) {
    if (this.playing) this.awaited = frame;
  }

  /** Something went wrong: if a step was awaited, it does not come, and the one after it is tried, as long as there is another. */
  failed() {
    const { scene } = this.app;
    if (!this.playing || scene.frame === this.awaited) return;
    const next = (this.awaited + 1) % scene.frame_count;
    if (next === scene.frame) this.stop();
    else this.ask(next);
  }

  show() {
    this.button.textContent = this.playing ? "Pause" : "Play";
  }
}
