// Drawn over the picture: the axes, a scale bar, and a ring around the particle that was picked.

import { basis, dot, halfHeight, heightAtTarget, sub } from "./camera.js";

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vec} Vec */

const SVG = "http://www.w3.org/2000/svg";
const ARM = 26; // pixels
const BAR = 140; // pixels that a scale bar takes at most

/** @param {string} name @param {Record<string, string | number>} attributes */
function shape(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  return made;
}

/** The largest of 1, 2, 5, 10, 20 ... that is not above a length. @param {number} length */
export function roundLength(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return ([5, 2].find((m) => m * power <= length * 1.000001) ?? 1) * power;
}

/** A length for people, without trailing noise. @param {number} length */
const lengthText = (length) => (length >= 1e5 || length < 1e-4 ? length.toExponential(0).replace("e+", "e") : String(Number(length.toPrecision(3))));

/**
 * Where a sphere appears: centre and radius in pixels from the upper left, or null behind the eye. A sphere beside the
 * middle of a perspective picture is an ellipse; its mean radius is near enough.
 * @param {Camera} camera @param {Vec} centre @param {number} radius @param {number} width @param {number} height
 */
export function project(camera, centre, radius, width, height) {
  const { right, up, forward } = basis(camera);
  const away = sub(centre, camera.eye);
  const depth = dot(away, forward);
  if (camera.height === null && depth <= 0) return null;
  const scale = height / 2 / halfHeight(camera) / (camera.height === null ? depth : 1);
  return { x: width / 2 + dot(away, right) * scale, y: height / 2 - dot(away, up) * scale, r: radius * scale };
}

export class Overlay {
  /** @param {SVGSVGElement} svg */
  constructor(svg) {
    this.svg = svg;
    this.axes = shape("g", { class: "axes" });
    this.bar = shape("g", { class: "scale" });
    this.ring = shape("circle", { class: "ring", visibility: "hidden" });
    svg.append(this.ring, this.axes, this.bar);
    /** What is drawn, so that nothing is drawn twice. */
    this.drawn = "";
  }

  /**
   * @param {Camera} camera normalised
   * @param {{unit: number}} scene
   * @param {{centre: Vec, radius: number} | null} picked normalised
   * @returns {{x: number, y: number, r: number} | null} where the picked particle is
   */
  draw(camera, scene, picked) {
    const [width, height] = [this.svg.clientWidth, this.svg.clientHeight];
    const at = picked && project(camera, picked.centre, picked.radius, width, height);
    const state = JSON.stringify([camera, scene.unit, picked, width, height]);
    if (state === this.drawn) return at;
    this.drawn = state;
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.drawAxes(camera, height);
    this.drawBar(camera, scene.unit, width, height);
    this.ring.setAttribute("visibility", at ? "visible" : "hidden");
    if (at) {
      for (const [key, value] of Object.entries({ cx: at.x, cy: at.y, r: Math.max(5, at.r + 2) })) this.ring.setAttribute(key, value.toFixed(1));
    }
    return at;
  }

  /** @param {Camera} camera @param {number} height */
  drawAxes(camera, height) {
    const { right, up, forward } = basis(camera);
    const [x0, y0] = [46, height - 78];
    const arms = [0, 1, 2].map((k) => ({ k, x: right[k], y: -up[k], depth: forward[k] }));
    arms.sort((a, b) => b.depth - a.depth); // the nearest last, over the others
    this.axes.replaceChildren(...arms.flatMap(({ k, x, y }) => {
      const reach = Math.hypot(x, y);
      const line = shape("line", { x1: x0, y1: y0, x2: (x0 + ARM * x).toFixed(1), y2: (y0 + ARM * y).toFixed(1), class: "xyz"[k] });
      if (reach < 0.15) return [line]; // it points at the viewer: a letter would hide the others
      const beyond = ARM + 9 / reach;
      const letter = shape("text", { x: (x0 + beyond * x).toFixed(1), y: (y0 + beyond * y).toFixed(1), class: "xyz"[k] });
      letter.textContent = "xyz"[k];
      return [line, letter];
    }));
  }

  /** @param {Camera} camera @param {number} unit @param {number} width @param {number} height */
  drawBar(camera, unit, width, height) {
    const across = (heightAtTarget(camera) * unit * BAR) / height; // file units
    if (!(across > 0 && Number.isFinite(across))) return this.bar.replaceChildren();
    const length = roundLength(across);
    const pixels = (BAR * length) / across;
    const [x1, y] = [width - 20, height - 18];
    const x0 = x1 - pixels;
    const path = shape("path", { d: `M${x0.toFixed(1)} ${y - 5}v5H${x1}v-5` });
    const text = shape("text", { x: ((x0 + x1) / 2).toFixed(1), y: y - 7 });
    // In perspective, a length is that long only where the camera looks.
    text.textContent = camera.height === null ? `≈ ${lengthText(length)}` : lengthText(length);
    this.bar.replaceChildren(path, text);
  }
}
