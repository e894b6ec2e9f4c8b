// The line between two pictures: dragged, or moved with the keys of any slider.

import { finder } from "./dom.js";

const STEP = 0.02;
const PAGE = 0.1;

export class Divider {
  /** @param {HTMLElement} root @param {(split: number) => void} moved called with the fraction of the width to the left of it */
  constructor(root, moved) {
    this.moved = moved;
    this.split = 0.5;
    const element = finder(root);
    this.stage = element("stage");
    /** @type {HTMLElement} */
    this.line = element("divider");
    this.left = element("left-label");
    this.right = element("right-label");
    /** Where on the line it was taken, in pixels. */
    this.hold = 0;
    const { line } = this;
    line.addEventListener("pointerdown", (event) => {
      line.setPointerCapture(event.pointerId);
      line.focus({ preventScroll: true });
      this.hold = event.clientX - (line.getBoundingClientRect().left + line.offsetWidth / 2);
      event.preventDefault();
    });
    line.addEventListener("pointermove", (event) => {
      if (!line.hasPointerCapture(event.pointerId)) return;
      const box = this.stage.getBoundingClientRect();
      this.move((event.clientX - this.hold - box.left) / box.width);
    });
    line.addEventListener("dblclick", () => this.move(0.5));
    line.addEventListener("keydown", (event) => this.key(event));
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const steps = /** @type {Record<string, number>} */ ({
      ArrowLeft: -STEP, ArrowDown: -STEP, ArrowRight: STEP, ArrowUp: STEP, PageDown: -PAGE, PageUp: PAGE, Home: -1, End: 1,
    });
    if (!(event.key in steps)) return;
    event.preventDefault();
    this.move(Math.round(1e4 * (this.split + steps[event.key])) / 1e4);
  }

  /** @param {number} split */
  move(split) {
    this.split = Math.max(0, Math.min(1, split));
    this.place();
    this.moved(this.split);
  }

  /** @param {boolean} on @param {string} left what is shown there, in words @param {string} right */
  show(on, left, right) {
    for (const each of [this.line, this.left, this.right]) each.hidden = !on;
    this.left.textContent = left;
    this.right.textContent = right;
    this.place();
  }

  place() {
    const percent = Math.round(100 * this.split);
    this.stage.style.setProperty("--split", `${100 * this.split}%`);
    this.line.setAttribute("aria-valuenow", String(percent));
    this.line.setAttribute("aria-valuetext", `${percent} % ${this.left.textContent}, ${100 - percent} % ${this.right.textContent}`);
  }
}
