// The particle that was picked: its ring and its tooltip, which follow it while the camera moves.

import { finder } from "./dom.js";

/** @typedef {import("./camera.js").Camera} Camera */

export class Pick {
  /**
   * @param {HTMLElement} root
   * @param {{inspect: (id: number) => void, shown: () => import("./hiding.js").Shown, swell: () => number, redraw: () => void}} host
   */
  constructor(root, host) {
    this.tip = finder(root)("readout");
    this.host = host;
    this.id = -1;
    /** Where it is, if it is not among the particles here. @type {{centre: import("./camera.js").Vec, radius: number} | null} */
    this.given = null;
    /** What the server said of it. @type {{id: number, number: number, position: string, radius: string, values: [string, string][]} | null} */
    this.details = null;
  }

  /** @param {number} id -1 for none @param {{centre: import("./camera.js").Vec, radius: number} | null} [sphere] if it is not among the particles here */
  set(id, sphere = null) {
    this.id = id;
    this.given = sphere;
    this.details = null;
    if (id >= 0) this.host.inspect(id);
    this.write();
    this.host.redraw();
  }

  /** @param {any} head of a particle message */
  take(head) {
    if (head.id !== this.id) return;
    this.details = head;
    this.write();
  }

  /** Centre and radius in normalised units. */
  get sphere() {
    const { spheres, drawn, loaded } = this.host.shown();
    const { id, given } = this;
    if (given) return given;
    if (id < 0 || id >= loaded || drawn[4 * id + 3] === 0) return null;
    /** @type {import("./camera.js").Vec} */
    const centre = [spheres[4 * id], spheres[4 * id + 1], spheres[4 * id + 2]];
    return { centre, radius: drawn[4 * id + 3] * this.host.swell() };
  }

  write() {
    const { details } = this;
    const lines = [`particle ${details?.number ?? this.id}`];
    if (details) lines.push(`at ${details.position}`, `radius ${details.radius}`, ...details.values.map(([name, text]) => `${name} ${text}`));
    this.tip.textContent = lines.join("\n");
  }

  /** Put the tooltip beside the particle. @param {{x: number, y: number, r: number} | null} at pixels @param {number} width @param {number} height */
  place(at, width, height) {
    const { tip } = this;
    const inside = at !== null && at.x > -at.r && at.x < width + at.r && at.y > -at.r && at.y < height + at.r;
    tip.hidden = !inside;
    if (!inside) return;
    const [w, h] = [tip.offsetWidth, tip.offsetHeight];
    const gap = Math.min(at.r, 60) + 12;
    const right = at.x + gap + w < width - 8;
    const x = right ? at.x + gap : at.x - gap - w;
    tip.style.translate = `${Math.round(Math.max(8, Math.min(width - w - 8, x)))}px ${Math.round(Math.max(8, Math.min(height - h - 8, at.y - h / 2)))}px`;
  }
}
