// Draws particles: ids first, then light and colour once a pixel, then tone.
//
// The id pass finds the nearest sphere of every pixel exactly. The shading pass sums samples into one of two pairs of
// float textures, so that a picture can grow smooth in the background while the last one stays on screen. The last
// pass turns sums into a picture; exposure and background need no other.

import { basis, dot, halfHeight, length, scale, sub, add } from "./camera.js";
import { toLinear } from "./colors.js";
import { GraphicsError, Program, Readback, Target, Texture, signalled } from "./gl.js";
import { LightSet } from "./lightset.js";
import * as shaders from "./shaders.js";

/** @typedef {import("./camera.js").Camera} Camera */

export const PARTICLES_WIDTH = 2048; // of textures with something for each particle; the shaders know it
const NEAR = 1e-6;
const FRAMES_IN_FLIGHT = 2;
const QUADS = 1 << 16; // particles in one draw call

/** @typedef {{width: number, height: number, epoch: number}} Shape */
/**
 * Which particles to draw: those of the list, and every `stride`-th from `first` on; none of these if it is 0. And whether
 * textures of small ones are filtered.
 * @typedef {{listed: boolean, first: number, stride: number, filtered: boolean}} Drawn
 */
/** @type {Drawn} */
export const ALL = { listed: false, first: 0, stride: 1, filtered: true };
/** @type {Drawn} */
export const LISTED = { listed: true, first: 0, stride: 0, filtered: true };

/** @typedef {{fence: WebGLSync, since: number, kind: string, count: number}} Frame */
/** Kind of full-size frames of all particles. */
export const WHOLE = "all 1";

export class Renderer {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", {
      alpha: false, antialias: false, depth: false, powerPreference: "high-performance", desynchronized: false,
    });
    if (gl === null) throw new GraphicsError("this browser has no WebGL2 — enable hardware acceleration or use another");
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) {
      throw new GraphicsError("this graphics driver cannot draw to floating point textures");
    }
    this.gl = gl;
    this.canvas = canvas;
    this.name = String(gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
    this.programs = {
      points: new Program(gl, "points", shaders.idsVertex(true), shaders.IDS_FRAGMENT),
      quads: new Program(gl, "quads", shaders.idsVertex(false), shaders.IDS_FRAGMENT),
      sweep: new Program(gl, "sweep", shaders.SCREEN_VERTEX, shaders.SWEEP_FRAGMENT),
      whole: new Program(gl, "present", shaders.SCREEN_VERTEX, shaders.presentFragment(true)),
      scaled: new Program(gl, "present scaled", shaders.SCREEN_VERTEX, shaders.presentFragment(false)),
    };
    /** Shading programs, by what they are made for. @type {Map<string, Program>} */
    this.shading = new Map();
    this.particlesMax = PARTICLES_WIDTH * gl.getParameter(gl.MAX_TEXTURE_SIZE);
    this.pointMax = gl.getParameter(gl.ALIASED_POINT_SIZE_RANGE)[1];
    this.count = 0;
    this.loaded = 0;
    /** Particles that those here stand for, if they are an even part of more. */
    this.total = 0;
    /** @type {Texture | null} */
    this.spheres = null;
    this.values = new Texture(gl, "r32f", 1, 1);
    this.lut = new Texture(gl, "rgba32f", 1, 1);
    /** What lights the particles: the first, and another to the right of `split` if there is one. */
    this.sets = [new LightSet(gl)];
    /** Where the second set begins, as a fraction of the picture's width. */
    this.split = 0.5;
    /** @type {{ids: Target, sums: Target[], capture: Target, sweep: Target} | null} */
    this.targets = null;
    this.readback = new Readback(gl);
    /** @type {Frame[]} */
    this.frames = [];
    this.frameMs = 16;
    /** Milliseconds that the last full-size frame of all particles took, and how many these were. */
    this.whole = { count: 0, ms: 0 };
    /** Milliseconds that a frame of a kind takes. @type {Map<string, number>} */
    this.times = new Map();
    this.frameCount = 0;
    this.doneAt = 0;
    this.look = {
      uniform: true, packed: false, color: [0.85, 0.83, 0.8], noData: [0.5, 0.5, 0.52], exposure: 1, top: [0, 0, 0], bottom: [0, 0, 0],
    };
    this.sceneRadius = 2;
    this.list = new Texture(gl, "r32ui", 1, 1);
    this.listCount = 0;
    gl.disable(gl.DITHER);
    gl.bindVertexArray(gl.createVertexArray());
    const corners = new Uint32Array(6 * QUADS);
    for (let k = 0; k < QUADS; k++) corners.set([4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 2, 4 * k + 1, 4 * k + 3], 6 * k);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  }

  /** Keep the particles that are known to be all that is visible, for drawing them alone. @param {Int32Array} ids */
  setList(ids) {
    const rows = Math.max(1, Math.ceil(ids.length / PARTICLES_WIDTH));
    if (this.list.width !== PARTICLES_WIDTH || this.list.height < rows) {
      this.list.delete();
      this.list = new Texture(this.gl, "r32ui", PARTICLES_WIDTH, rows);
    }
    const padded = new Uint32Array(rows * PARTICLES_WIDTH);
    padded.set(ids);
    this.list.rows(padded, 0, rows);
    this.listCount = ids.length;
  }

  /** Make room for particles; they arrive by parts. @param {number} count @param {number} sceneRadius @param {number} [total] see there */
  setScene(count, sceneRadius, total = 0) {
    const { gl } = this;
    const rows = Math.max(1, Math.ceil(count / PARTICLES_WIDTH));
    if (count > this.particlesMax) {
      throw new GraphicsError(`${count} particles are too many for this graphics driver: it takes ${this.particlesMax}`);
    }
    for (const texture of [this.spheres, this.values]) texture?.delete();
    this.spheres = new Texture(gl, "rgba32f", PARTICLES_WIDTH, rows);
    this.values = new Texture(gl, "r32f", PARTICLES_WIDTH, rows);
    this.count = count;
    this.loaded = 0;
    this.total = total;
    this.sceneRadius = sceneRadius;
  }

  /** @param {number} start a multiple of the texture's width @param {Float32Array} spheres (K, 4) */
  setSpheres(start, spheres) {
    if (this.spheres === null) return;
    uploadRows(this.spheres, spheres, start, 4);
    this.loaded = Math.max(this.loaded, start + spheres.length / 4);
  }

  /**
   * Factor on radii: a part of the particles fills as much space as all of them. As small as they are it would have holes, through
   * which one sees into the dark inside.
   */
  get swell() {
    return Math.cbrt(Math.max(1, this.total / Math.max(1, this.loaded)));
  }

  /** @param {Float32Array} values (K,) positions in the colour map, or packed colours; negative for no data @param {number} [start] a multiple of the texture's width */
  setValues(values, start = 0) {
    uploadRows(this.values, values, start, 1);
  }

  /** @param {Uint8Array} lut (n, 3) sRGB */
  setLut(lut) {
    const rows = lut.length / 3;
    const table = new Float32Array(4 * rows);
    for (let k = 0; k < rows; k++) for (let c = 0; c < 3; c++) table[4 * k + c] = toLinear(lut[3 * k + c] / 255);
    this.lut.delete();
    this.lut = new Texture(this.gl, "rgba32f", rows, 1);
    this.lut.rows(table, 0, 1);
  }

  /** Fit all targets to the canvas. */
  resize() {
    const { gl } = this;
    const { width, height } = this.canvas;
    if (this.targets?.ids.width === width && this.targets.ids.height === height) return;
    if (this.targets) for (const target of Object.values(this.targets).flat()) target.delete();
    const ids = new Target(gl, width, height, ["r32ui"], true);
    this.targets = {
      ids,
      sums: [0, 1, 2].map(() => new Target(gl, width, height, ["rgba16f", "r16f"], ids)),
      capture: new Target(gl, width, height, ["rgba8"], false),
      sweep: new Target(gl, width, height, ["r32ui"], false),
    };
  }

  /** Whether the graphics processor is still busy with earlier frames; also keeps the time that a frame takes. */
  get busy() {
    while (this.frames.length && signalled(this.gl, this.frames[0].fence)) {
      const { fence, since, kind, count } = /** @type {Frame} */ (this.frames.shift());
      this.gl.deleteSync(fence);
      const now = performance.now();
      const took = now - Math.max(since, this.doneAt), before = this.times.get(kind) ?? took;
      this.frameMs += 0.3 * (took - this.frameMs);
      this.times.set(kind, before + 0.3 * (took - before));
      if (kind === WHOLE) this.whole = { count, ms: took };
      this.doneAt = now;
      this.frameCount++;
    }
    return this.frames.length >= FRAMES_IN_FLIGHT;
  }

  /** Call after the commands of a frame. @param {string} kind */
  endFrame(kind) {
    const fence = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (fence !== null) this.frames.push({ fence, since: performance.now(), kind, count: this.loaded });
    this.gl.flush();
  }

  /** @param {Program} program @param {Camera} camera @param {number[]} shift @param {Shape} shape */
  setCamera(program, camera, shift, shape) {
    const { right, up, forward } = basis(camera);
    const half = halfHeight(camera);
    const origin = camera.height === null ? camera.eye : add(camera.eye, scale(forward, ahead(camera)));
    const high = origin.map(Math.fround);
    program.use()
      .texture("uSpheres", /** @type {Texture} */ (this.spheres))
      .float("uEyeHigh", high).float("uEyeLow", origin.map((x, k) => x - high[k]))
      .mat3("uBasis", [...right, ...up, ...forward])
      .float("uHalf", [half * shape.width / shape.height, half])
      .float("uSize", [shape.width, shape.height]).float("uShift", shift)
      .int("uOrthographic", camera.height === null ? 0 : 1).float("uSwell", this.swell);
  }

  /**
   * Find the nearest sphere of every pixel, then add its light to a pair of sums.
   * @param {Camera} camera @param {number[]} shift of the rays within their pixels, in pixels
   * @param {Shape} shape @param {number} pair @param {boolean} first whether to start the sums anew
   * @param {Drawn} drawn
   */
  drawSample(camera, shift, shape, pair, first, drawn) {
    if (this.targets === null || this.spheres === null) return;
    this.drawIds(camera, shift, shape, drawn);
    // Samples after the first fall between: together they need no filter, which would only blur them.
    this.shade(camera, shift, shape, pair, first, first && drawn.filtered);
  }

  /** Find the nearest sphere of every pixel. @param {Camera} camera @param {number[]} shift @param {Shape} shape @param {Drawn} drawn */
  drawIds(camera, shift, shape, { listed, first, stride }) {
    const { gl, targets } = this;
    if (targets === null) return;
    targets.ids.bind(shape.width, shape.height);
    gl.clearBufferuiv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.clearBufferfv(gl.DEPTH, 0, [0]);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.GREATER);
    // Points reach across the picture at most.
    const points = Math.max(shape.width, shape.height) < this.pointMax;
    const program = points ? this.programs.points : this.programs.quads;
    this.setCamera(program, camera, shift, shape);
    program.float("uNear", NEAR).float("uFar", length(camera.eye) + this.sceneRadius).float("uStart", camera.height === null ? 0 : -ahead(camera))
      .texture("uList", this.list);
    const draw = (/** @type {number} */ from, /** @type {number} */ count, /** @type {number} */ step) => {
      program.int("uStride", step);
      for (let k = 0; k < count; k += QUADS) {
        program.int("uFirst", from + k * step);
        const part = Math.min(QUADS, count - k);
        if (points) gl.drawArrays(gl.POINTS, 0, part);
        else gl.drawElements(gl.TRIANGLES, 6 * part, gl.UNSIGNED_INT, 0);
      }
    };
    if (listed) {
      program.int("uListed", 1);
      draw(0, this.listCount, 1);
    }
    if (stride > 0 && first < this.loaded) {
      program.int("uListed", 0);
      draw(first, Math.ceil((this.loaded - first) / stride), stride);
    }
    gl.disable(gl.DEPTH_TEST);
  }

  /** Add the light of what is in the id buffer to a pair of sums. @param {Camera} camera @param {number[]} shift @param {Shape} shape @param {number} pair @param {boolean} first @param {boolean} filtered */
  shade(camera, shift, shape, pair, first, filtered) {
    const { gl, targets } = this;
    if (targets === null) return;
    targets.sums[pair].bind(shape.width, shape.height);
    if (first) for (const k of [0, 1]) gl.clearBufferfv(gl.COLOR, k, [0, 0, 0, 0]);
    else gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS); // leaves out what nothing covers
    gl.depthMask(false);
    this.eachSet(shape.width, shape.height, (set) => {
      const program = this.shadingFor(set, filtered);
      this.setCamera(program, camera, shift, shape);
      program.texture("uIds", targets.ids.colors[0]).texture("uValues", this.values).texture("uLut", this.lut)
        .int("uUniform", this.look.uniform ? 1 : 0).int("uPacked", this.look.packed ? 1 : 0).float("uColor", this.look.color).float("uNoData", this.look.noData);
      set.bind(program);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    });
    gl.depthMask(true);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
  }

  /** The program that shades what a set holds. @param {LightSet} set @param {boolean} filtered */
  shadingFor(set, filtered) {
    const traits = { ...set.traits(), filtered };
    const key = JSON.stringify(traits);
    let program = this.shading.get(key);
    if (program === undefined) {
      program = new Program(this.gl, "shade", shaders.SCREEN_VERTEX, shaders.shadeFragment(traits));
      this.shading.set(key, program);
    }
    return program;
  }

  /** Call `draw` for each set, with all but its part of the picture masked. @param {number} width @param {number} height @param {(set: LightSet) => void} draw */
  eachSet(width, height, draw) {
    const { gl, sets } = this;
    if (sets.length === 1) return draw(sets[0]);
    const middle = Math.round(width * this.split);
    gl.enable(gl.SCISSOR_TEST);
    sets.slice(0, 2).forEach((set, k) => {
      gl.scissor(k ? middle : 0, 0, k ? width - middle : middle, height);
      draw(set);
    });
    gl.disable(gl.SCISSOR_TEST);
  }

  /** Show a pair of sums, on the canvas or elsewhere. @param {number} pair @param {number} samples @param {Shape} shape @param {Target | null} [target] */
  present(pair, samples, shape, target = null) {
    const { gl, targets, look } = this;
    if (targets === null) return;
    const { width, height } = this.canvas;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target?.framebuffer ?? null);
    gl.viewport(0, 0, width, height);
    const sums = targets.sums[pair];
    const program = shape.width === width && shape.height === height ? this.programs.whole : this.programs.scaled;
    program.use()
      .texture("uSum", sums.colors[0]).texture("uCover", sums.colors[1])
      .float("uCanvas", [width, height])
      .float("uPart", [shape.width / sums.width, shape.height / sums.height])
      .float("uCount", samples).float("uExposure", look.exposure)
      .float("uTop", look.top).float("uBottom", look.bottom);
    this.eachSet(width, height, (set) => {
      program.float("uWhite", set.white);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    });
  }

  /**
   * Start to read every `step`-th pixel of the last id pass back.
   * @param {Shape} shape @param {number} step @param {number} turn which pixel of each block
   * @returns {boolean} false while an earlier one is under way
   */
  sweep(shape, step, turn) {
    const { targets } = this;
    if (targets === null || this.readback.pending) return false;
    const width = Math.ceil(shape.width / step);
    const height = Math.ceil(shape.height / step);
    targets.sweep.bind(width, height);
    const at = (turn * 7) % (step * step); // 7 shares no factor with 4 or 16, so every pixel of a block has its turn
    this.programs.sweep.use().texture("uIds", targets.ids.colors[0]).int("uStep", step)
      .float("uFirst", [at % step, Math.floor(at / step)]).float("uSize", [shape.width, shape.height]);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
    this.readback.start(width, height, shape.epoch);
    return true;
  }

  /** The id at a point of the picture, or -1; waits for it. @param {Camera} camera @param {number} x fraction from the left @param {number} y from the bottom */
  idAt(camera, x, y) {
    this.resize();
    const { gl } = this;
    const { width, height } = this.canvas;
    this.drawIds(camera, [0, 0], { width, height, epoch: 0 }, ALL);
    const wide = new Uint32Array(4);
    const at = [x * width, y * height].map((place, k) => Math.max(0, Math.min([width, height][k] - 1, Math.floor(place))));
    gl.readPixels(at[0], at[1], 1, 1, gl.RGBA_INTEGER, gl.UNSIGNED_INT, wide);
    return wide[0] - 1;
  }

  /** The picture and the ids at full size, one ray through the middle of every pixel; waits for them. @param {Camera} camera */
  capture(camera) {
    this.resize();
    const { gl } = this;
    const targets = /** @type {NonNullable<typeof this.targets>} */ (this.targets);
    const { width, height } = this.canvas;
    const shape = { width, height, epoch: 0 };
    this.drawSample(camera, [0, 0], shape, 2, true, ALL); // a third pair, so that the picture on screen goes on undisturbed
    this.present(2, 1, shape, targets.capture);
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const wide = new Uint32Array(4 * width * height);
    targets.ids.bind();
    gl.readPixels(0, 0, width, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, wide);
    const ids = new Int32Array(width * height);
    for (let k = 0; k < ids.length; k++) ids[k] = wide[4 * k] - 1;
    return { width, height, pixels, ids };
  }
}

/** From the eye to the plane through the target. @param {Camera} camera */
const ahead = (camera) => dot(sub(camera.target, camera.eye), basis(camera).forward);

/** @param {Texture} texture @param {Float32Array} data @param {number} start in particles @param {number} channels */
function uploadRows(texture, data, start, channels) {
  const rowLength = texture.width * channels;
  const full = Math.floor(data.length / rowLength);
  const first = start / texture.width;
  if (full) texture.rows(data.subarray(0, full * rowLength), first, full);
  const rest = data.subarray(full * rowLength);
  if (rest.length) {
    const padded = new Float32Array(rowLength);
    padded.set(rest);
    texture.rows(padded, first + full, 1);
  }
}
