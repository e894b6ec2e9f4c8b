// Draws particles: ids first, then light and colour once a pixel, then tone.
//
// The id pass finds the nearest sphere of every pixel exactly. The shading pass sums samples into one of two pairs of
// float textures, so that a picture can grow smooth in the background while the last one stays on screen. The last
// pass turns sums into a picture; exposure and background need no other.

import { basis, halfHeight, length, sub } from "./camera.js";
import { toLinear } from "./colors.js";
import { GraphicsError, Program, Readback, Target, Texture, signalled } from "./gl.js";
import * as shaders from "./shaders.js";
import { LAYER_ROWS } from "./tiles.js";

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./coarse.js").CoarseStore} CoarseStore */
/** @typedef {import("./tiles.js").TileStore} TileStore */

export const PARTICLES_WIDTH = 2048;
const MAPPINGS = ["latlong", "octahedral"]; // in the order of the shader's uMapping
const NEAR = 1e-6;
const FRAMES_IN_FLIGHT = 2;
const QUADS = 1 << 16; // particles in one draw call

/** @typedef {{width: number, height: number, epoch: number}} Shape */
/** @typedef {{fence: WebGLSync, since: number, pixels: number}} Frame */

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
      ids: new Program(gl, "ids", shaders.IDS_VERTEX, shaders.IDS_FRAGMENT),
      shade: new Program(gl, "shade", shaders.SCREEN_VERTEX, shaders.SHADE_FRAGMENT),
      sweep: new Program(gl, "sweep", shaders.SCREEN_VERTEX, shaders.SWEEP_FRAGMENT),
      present: new Program(gl, "present", shaders.SCREEN_VERTEX, shaders.PRESENT_FRAGMENT),
    };
    this.count = 0;
    this.loaded = 0;
    /** @type {Texture | null} */
    this.spheres = null;
    this.values = new Texture(gl, "r32f", 1, 1);
    this.slots = new Texture(gl, "r32i", 1, 1);
    this.atlas = new Texture(gl, "r8ui", 1, 1, { layers: 1 });
    this.decoding = new Texture(gl, "r32f", 256, 64);
    this.coarse = new Texture(gl, "rgba16f", 1, 1);
    this.lut = new Texture(gl, "rgba32f", 1, 1);
    /** @type {{ids: Target, sums: Target[], capture: Target, sweep: Target} | null} */
    this.targets = null;
    this.readback = new Readback(gl);
    /** @type {Frame[]} */
    this.frames = [];
    this.frameMs = 16;
    this.framePixels = 1;
    this.frameCount = 0;
    this.doneAt = 0;
    this.look = {
      uniform: true, packed: false, color: [0.85, 0.83, 0.8], noData: [0.5, 0.5, 0.52], exposure: 1, white: 1,
      top: [0, 0, 0], bottom: [0, 0, 0], useTiles: false, texels: 16, mapping: 0, coarseScale: 1,
    };
    /** @type {any} */
    this.light = { sky: [1, 1, 0, 0, 1], suns: [], globes: [], quads: [] };
    this.sceneRadius = 2;
    this.list = new Texture(gl, "r32ui", 1, 1);
    this.listCount = 0;
    this.useCoarse = false;
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

  /** Make room for particles; they arrive by parts. @param {number} count @param {number} sceneRadius */
  setScene(count, sceneRadius) {
    const { gl } = this;
    const rows = Math.max(1, Math.ceil(count / PARTICLES_WIDTH));
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (rows > most) {
      throw new GraphicsError(`${count} particles are too many for this graphics driver: it takes ${most * PARTICLES_WIDTH}`);
    }
    for (const texture of [this.spheres, this.values, this.slots]) texture?.delete();
    this.spheres = new Texture(gl, "rgba32f", PARTICLES_WIDTH, rows);
    this.values = new Texture(gl, "r32f", PARTICLES_WIDTH, rows);
    this.slots = new Texture(gl, "r32i", PARTICLES_WIDTH, rows);
    this.count = count;
    this.loaded = 0;
    this.sceneRadius = sceneRadius;
  }

  /** @param {number} start a multiple of the texture's width @param {Float32Array} spheres (K, 4) */
  setSpheres(start, spheres) {
    if (this.spheres === null) return;
    uploadRows(this.spheres, spheres, start, 4);
    this.loaded = Math.max(this.loaded, start + spheres.length / 4);
  }

  /** @param {Float32Array} values (N,) positions in the colour map, or packed colours; negative for no data */
  setValues(values) {
    uploadRows(this.values, values, 0, 1);
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

  /** How texels lie on a sphere. @param {{texels: number, mapping: string}} scene */
  setTexels({ texels, mapping }) {
    this.look.texels = texels;
    this.look.mapping = MAPPINGS.indexOf(mapping);
  }

  /** @param {TileStore} tiles */
  setAtlas(tiles) {
    const layers = Math.ceil(tiles.rows / LAYER_ROWS);
    this.atlas.delete();
    this.atlas = new Texture(this.gl, "r8ui", 2048, Math.min(tiles.rows, LAYER_ROWS), { layers });
    tiles.touchAll();
  }

  /** Upload what changed in the atlas. @param {TileStore} tiles */
  uploadTiles(tiles) {
    tiles.dirtyAtlas.flush((first, count) => {
      for (let row = first; row < first + count;) {
        const layer = Math.floor(row / LAYER_ROWS);
        const rows = Math.min(first + count, (layer + 1) * LAYER_ROWS) - row;
        this.atlas.rows(tiles.bytes.subarray(row * 2048, (row + rows) * 2048), row % LAYER_ROWS, rows, layer);
        row += rows;
      }
    });
    tiles.dirtySlots.flush((first, count) => {
      this.slots.rows(tiles.slots.subarray(first * tiles.width, (first + count) * tiles.width), first, count);
    });
    if (tiles.dirtyDecoding) {
      this.decoding.rows(tiles.decoding, 0, 64);
      tiles.dirtyDecoding = false;
    }
  }

  /** Upload what changed in the coarse records. @param {CoarseStore} coarse */
  uploadCoarse(coarse) {
    this.useCoarse = coarse.used;
    if (!coarse.used) return;
    if (this.coarse.width !== coarse.width || this.coarse.height !== coarse.rows) {
      this.coarse.delete();
      this.coarse = new Texture(this.gl, "rgba16f", coarse.width, coarse.rows);
      coarse.dirty.all();
    }
    coarse.dirty.flush((first, count) => {
      this.coarse.rows(coarse.data.subarray(4 * first * coarse.width, 4 * (first + count) * coarse.width), first, count);
    });
  }

  /** Fit all targets to the canvas. */
  resize() {
    const { gl } = this;
    const { width, height } = this.canvas;
    if (this.targets?.ids.width === width && this.targets.ids.height === height) return;
    if (this.targets) for (const target of Object.values(this.targets).flat()) target.delete();
    this.targets = {
      ids: new Target(gl, width, height, ["r32ui"], true),
      sums: [0, 1, 2].map(() => new Target(gl, width, height, ["rgba16f", "r16f"], false)),
      capture: new Target(gl, width, height, ["rgba8"], false),
      sweep: new Target(gl, width, height, ["r32ui"], false),
    };
  }

  /** Whether the graphics processor is still busy with earlier frames; also keeps the time that a frame takes. */
  get busy() {
    while (this.frames.length && signalled(this.gl, this.frames[0].fence)) {
      const { fence, since, pixels } = /** @type {Frame} */ (this.frames.shift());
      this.gl.deleteSync(fence);
      const now = performance.now();
      this.frameMs += 0.3 * (now - Math.max(since, this.doneAt) - this.frameMs);
      this.framePixels = pixels;
      this.doneAt = now;
      this.frameCount++;
    }
    return this.frames.length >= FRAMES_IN_FLIGHT;
  }

  /** Call after the commands of a frame. @param {number} pixels */
  endFrame(pixels) {
    const fence = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (fence !== null) this.frames.push({ fence, since: performance.now(), pixels });
    this.gl.flush();
  }

  /** @param {Program} program @param {Camera} camera @param {number[]} shift @param {Shape} shape */
  setCamera(program, camera, shift, shape) {
    const { right, up, forward } = basis(camera);
    const half = halfHeight(camera);
    const high = camera.eye.map(Math.fround);
    program.use()
      .texture("uSpheres", /** @type {Texture} */ (this.spheres))
      .float("uEyeHigh", high).float("uEyeLow", camera.eye.map((x, k) => x - high[k]))
      .mat3("uBasis", [...right, ...up, ...forward])
      .float("uHalf", [half * shape.width / shape.height, half])
      .float("uSize", [shape.width, shape.height]).float("uShift", shift)
      .int("uOrthographic", camera.height === null ? 0 : 1);
  }

  /**
   * Find the nearest sphere of every pixel, then add its light to a pair of sums.
   * @param {Camera} camera @param {number[]} shift of the rays within their pixels, in pixels
   * @param {Shape} shape @param {number} pair @param {boolean} first whether to start the sums anew
   * @param {boolean} [listed] draw only the particles of the list
   */
  drawSample(camera, shift, shape, pair, first, listed = false) {
    const { gl, targets } = this;
    if (targets === null || this.spheres === null) return;
    targets.ids.bind(shape.width, shape.height);
    gl.clearBufferuiv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.clearBufferfv(gl.DEPTH, 0, [0]);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.GREATER);
    this.setCamera(this.programs.ids, camera, shift, shape);
    const far = length(camera.eye) + this.sceneRadius;
    this.programs.ids.float("uNear", NEAR).float("uFar", far).texture("uList", this.list).int("uListed", listed ? 1 : 0);
    const count = listed ? this.listCount : this.loaded;
    for (let start = 0; start < count; start += QUADS) {
      this.programs.ids.int("uFirst", start);
      gl.drawElements(gl.TRIANGLES, 6 * Math.min(QUADS, count - start), gl.UNSIGNED_INT, 0);
    }
    gl.disable(gl.DEPTH_TEST);

    targets.sums[pair].bind(shape.width, shape.height);
    const { shade } = this.programs;
    this.setCamera(shade, camera, shift, shape);
    shade.texture("uIds", targets.ids.colors[0]).texture("uValues", this.values).texture("uLut", this.lut)
      .texture("uSlots", this.slots).texture("uAtlas", this.atlas).texture("uDecoding", this.decoding)
      .texture("uCoarse", this.coarse).float("uCoarseScale", this.look.coarseScale)
      .int("uTexels", this.look.texels).int("uMapping", this.look.mapping).int("uUseTiles", this.look.useTiles ? 1 : 0)
      .int("uUseCoarse", this.useCoarse && this.look.useTiles ? 1 : 0)
      .int("uUniform", this.look.uniform ? 1 : 0).int("uPacked", this.look.packed ? 1 : 0).float("uColor", this.look.color).float("uNoData", this.look.noData);
    // Samples after the first fall between: together they need no filter, which would only blur them.
    shade.float("uSpacing", first ? 1 : 0);
    this.setLights(shade);
    if (!first) {
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.BLEND);
  }

  /** @param {Program} program */
  setLights(program) {
    const { sky, suns, globes, quads } = this.light;
    const most = shaders.LIGHTS_MAX;
    program.float("uSky", [sky[0], sky[1]]).float("uSkyAxis", [sky[2], sky[3], sky[4]]);
    const counts = [suns.length / 6, globes.length / 5, quads.length / 14].map((n) => Math.min(n, most));
    program.int("uSunCount", counts[0]).int("uGlobeCount", counts[1]).int("uQuadCount", counts[2]);
    const [s, g, q] = counts.map((n) => new Float32Array(8 * n));
    for (let k = 0; k < counts[0]; k++) s.set([suns[6 * k], suns[6 * k + 1], suns[6 * k + 2], suns[6 * k + 3], suns[6 * k + 4]], 8 * k);
    for (let k = 0; k < counts[1]; k++) g.set(globes.subarray(5 * k, 5 * k + 5), 8 * k);
    for (let k = 0; k < counts[2]; k++) {
      const l = quads.subarray(14 * k, 14 * k + 14);
      const middle = [0, 1, 2].map((a) => l[a] + 0.5 * (l[3 + a] + l[6 + a]));
      q.set([...middle, l[13], l[9], l[10], l[11], l[12]], 8 * k);
    }
    program.vec4s("uSuns", s).vec4s("uGlobes", g).vec4s("uQuads", q);
  }

  /** Show a pair of sums, on the canvas or elsewhere. @param {number} pair @param {number} samples @param {Shape} shape @param {Target | null} [target] */
  present(pair, samples, shape, target = null) {
    const { gl, targets, look } = this;
    if (targets === null) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target?.framebuffer ?? null);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    const sums = targets.sums[pair];
    this.programs.present.use()
      .texture("uSum", sums.colors[0]).texture("uCover", sums.colors[1])
      .float("uCanvas", [this.canvas.width, this.canvas.height])
      .float("uPart", [shape.width / sums.width, shape.height / sums.height])
      .float("uCount", samples).float("uExposure", look.exposure).float("uWhite", look.white)
      .float("uTop", look.top).float("uBottom", look.bottom);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
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

  /** The picture and the ids at full size, one ray through the middle of every pixel; waits for them. @param {Camera} camera */
  capture(camera) {
    this.resize();
    const { gl } = this;
    const targets = /** @type {NonNullable<typeof this.targets>} */ (this.targets);
    const { width, height } = this.canvas;
    const shape = { width, height, epoch: 0 };
    this.drawSample(camera, [0, 0], shape, 2, true); // a third pair, so that the picture on screen goes on undisturbed
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
