// What the page says in words: the status line below the picture, and what is wrong in the banner above it.

/** @typedef {import("./app.js").App} App */

const PASSING_MS = 8000;
const MILD = new Set(["notice", "waiting", "study", "drawing"]); // causes that are no trouble
const PERIOD_MS = 500; // between two status lines while frames are drawn
const FPS_MS = 400; // over which frames are counted

export class Notices {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** @type {Map<string, string>} what the banner says, by cause */
    this.troubles = new Map();
    /** What the server said last of how far it is. @type {any} */
    this.status = null;
    this.shownAt = 0;
    this.framesSeen = 0;
    this.fps = 0;
  }

  /** @param {any} head of a status message */
  takeStatus(head) {
    this.status = head;
    this.trouble("light", head.error ? `Light: ${head.error}` : null);
    if (head.ready || this.app.light.state?.model === "lambertian") this.trouble("notice", null);
    this.show();
  }

  /** A frame was drawn: say so now and then. */
  tick() {
    if (performance.now() - this.shownAt > PERIOD_MS) this.show();
  }

  show() {
    const { app } = this;
    const frameCount = app.remote.active ? app.remote.frames : app.drawing.renderer.frameCount;
    const now = performance.now();
    if (now - this.shownAt > FPS_MS) {
      const frames = frameCount - this.framesSeen;
      this.fps = frames > 1 ? (frames * 1000) / (now - this.shownAt) : 0;
      this.framesSeen = frameCount;
      this.shownAt = now;
    }
    if (app.scene === null) return;
    const { visible, ready, estimates, coarse, stale } = app.light.counts();
    const lambertian = app.light.state?.model === "lambertian";
    const n = (/** @type {number} */ x) => x.toLocaleString("en");
    const { loaded, count } = app.spheres.shown, part = app.arrival.text;
    const coming = part === null && loaded < count;
    const parts = [part ?? "", coming ? `${Math.floor((100 * loaded) / count)} % of the particles are here` : `${n(visible)} visible`].filter(Boolean);
    if (coming || visible === 0) {
      // The rest can be told once they are all here, and looked at.
    } else if (lambertian) {
      parts.push("no global light");
    } else if (app.light.baked) {
      parts.push(ready >= visible ? "baked light" : `${n(ready)} with baked light`);
    } else {
      parts.push(ready >= visible ? "all lit" : `${n(ready)} lit`);
      if (estimates) parts.push(`${n(estimates)} to be refined`);
      if (coarse) parts.push(`${n(coarse)} in first light`);
      if (stale) parts.push(`${n(stale)} in the light before`);
      if (this.status?.queued) parts.push(`${n(this.status.queued + this.status.baking)} queued`);
      if (ready < visible && this.status?.textures_per_s >= 1) parts.push(`${n(Math.round(this.status.textures_per_s))} textures/s`);
      if (app.light.store.dropped) parts.push("texture memory full");
    }
    const other = app.beside.counts();
    if (other && other.model !== "lambertian") parts.push(other.ready >= visible ? "right side lit" : `${n(other.ready)} lit on the right`);
    if (app.remote.active) parts.push("drawn by the server");
    if (this.fps >= 0.5 && !app.remote.shown?.final) parts.push(`${this.fps < 10 ? this.fps.toFixed(1) : Math.round(this.fps)} fps`);
    app.element("counts").textContent = parts.join("  ·  ");
    /** @type {HTMLProgressElement} */
    const progress = app.element("progress");
    progress.value = coming ? loaded / count : visible ? ready / visible : 0;
    progress.hidden = !coming && (lambertian || ready >= visible);
    progress.parentElement?.classList.toggle("stale", stale > 0);
  }

  /** Say what is wrong, or that it no longer is. @param {string} cause @param {string | null} text @param {boolean} [passing] goes away by itself */
  trouble(cause, text, passing = false) {
    if (text === null) this.troubles.delete(cause);
    else this.troubles.set(cause, text);
    if (passing && text !== null) {
      setTimeout(() => {
        if (this.troubles.get(cause) === text) this.trouble(cause, null);
      }, PASSING_MS);
    }
    const banner = this.app.element("banner");
    banner.textContent = [...this.troubles.values()].join("\n");
    banner.hidden = this.troubles.size === 0;
    banner.classList.toggle("mild", [...this.troubles.keys()].every((key) => MILD.has(key)));
  }
}
