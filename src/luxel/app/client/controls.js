// Mouse, touch and keyboard to camera moves.

import * as cameras from "./camera.js";

/** @typedef {import("./camera.js").Camera} Camera */

const TURN = 2 * Math.PI; // radians for a drag across the picture's height
const KEY_TURN = Math.PI / 36;
const KEY_PAN = 0.05;
const KEY_ZOOM = 0.88;

export class Controls {
  /**
   * @param {HTMLElement} element
   * @param {{get: () => Camera | null, set: (camera: Camera) => void, frame: () => void, axis: (axis: string, negative: boolean) => void, click: (x: number, y: number) => void, escape: () => void}} host
   */
  constructor(element, host) {
    this.element = element;
    this.host = host;
    /** @type {Map<number, {x: number, y: number}>} */
    this.pointers = new Map();
    this.moved = 0;
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
      element.addEventListener(name, (event) => this.up(event));
    }
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("dblclick", () => host.frame());
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("keydown", (event) => this.key(event));
  }

  /** @param {(camera: Camera) => Camera} change */
  change(change) {
    const camera = this.host.get();
    if (camera !== null) this.host.set(change(camera));
  }

  /** @param {PointerEvent} event */
  down(event) {
    this.element.setPointerCapture(event.pointerId);
    this.element.focus({ preventScroll: true });
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (this.pointers.size === 1) this.moved = 0;
  }

  /** @param {PointerEvent} event */
  up(event) {
    const known = this.pointers.delete(event.pointerId);
    if (known && event.type === "pointerup" && this.pointers.size === 0 && this.moved < 4 && event.button === 0) {
      const box = this.element.getBoundingClientRect();
      this.host.click((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
    }
  }

  /** @param {PointerEvent} event */
  move(event) {
    const last = this.pointers.get(event.pointerId);
    if (last === undefined) return;
    const height = this.element.clientHeight;
    const now = { x: event.clientX, y: event.clientY };
    const [dx, dy] = [(now.x - last.x) / height, (now.y - last.y) / height];
    this.moved += Math.abs(now.x - last.x) + Math.abs(now.y - last.y);
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
    this.pointers.set(event.pointerId, now);
    if (others.length === 1) {
      const [other] = others;
      const apart = (/** @type {{x: number, y: number}} */ p) => Math.max(10, Math.hypot(p.x - other.x, p.y - other.y));
      const [x, y] = this.fromCentre((now.x + other.x) / 2, (now.y + other.y) / 2);
      this.change((c) => cameras.pan(cameras.zoom(c, apart(last) / apart(now), x, y), dx / 2, -dy / 2));
    } else if (others.length === 0) {
      const panning = event.shiftKey || (event.buttons & 6) !== 0;
      const zooming = event.ctrlKey || event.metaKey;
      if (zooming) this.change((c) => cameras.zoom(c, Math.exp(3 * dy)));
      else if (panning) this.change((c) => cameras.pan(c, dx, -dy));
      else this.change((c) => cameras.orbit(c, -dx * TURN / 2, dy * TURN / 2));
    }
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : event.deltaMode === WheelEvent.DOM_DELTA_PAGE ? 300 : 1;
    const amount = Math.max(-200, Math.min(200, event.deltaY * lines));
    const [x, y] = this.fromCentre(event.clientX, event.clientY);
    this.change((c) => cameras.zoom(c, Math.exp(amount * 0.0015), x, y));
  }

  /** Position as a fraction of the height from the picture's centre, y upwards. @param {number} x @param {number} y */
  fromCentre(x, y) {
    const box = this.element.getBoundingClientRect();
    return [(x - box.left - box.width / 2) / box.height, -(y - box.top - box.height / 2) / box.height];
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { shiftKey } = event;
    const arrows = /** @type {Record<string, [number, number]>} */ ({
      ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
    });
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key in arrows) {
      const [x, y] = arrows[key];
      this.change((c) => (shiftKey ? cameras.pan(c, -x * KEY_PAN, -y * KEY_PAN) : cameras.orbit(c, x * KEY_TURN, y * KEY_TURN)));
    } else if (key === "+" || key === "=") this.change((c) => cameras.zoom(c, KEY_ZOOM));
    else if (key === "-" || key === "_") this.change((c) => cameras.zoom(c, 1 / KEY_ZOOM));
    else if (key === "f") this.host.frame();
    else if (key === "o") this.change(cameras.toggleProjection);
    else if (key === "Enter") this.host.click(0.5, 0.5);
    else if (key === "Escape") this.host.escape();
    else if (key === "x" || key === "y" || key === "z") this.host.axis(key, shiftKey);
    else return;
    event.preventDefault();
  }
}
