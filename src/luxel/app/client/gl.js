// Small pieces of WebGL2. They throw with the driver's own words where WebGL would carry on in silence.

/** @typedef {WebGL2RenderingContext} GL */

export class GraphicsError extends Error {}

export class Program {
  /** @param {GL} gl @param {string} name @param {string} vertex @param {string} fragment */
  constructor(gl, name, vertex, fragment) {
    this.gl = gl;
    const program = gl.createProgram();
    for (const [type, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(type));
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new GraphicsError(`shader "${name}" does not compile: ${gl.getShaderInfoLog(shader)}`);
      }
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new GraphicsError(`shader "${name}" does not link: ${gl.getProgramInfoLog(program)}`);
    }
    this.program = program;
    /** @type {Map<string, WebGLUniformLocation | null>} */
    this.places = new Map();
    this.unit = 0;
  }

  /** Make this the program that draws; texture units are counted anew. */
  use() {
    this.gl.useProgram(this.program);
    this.unit = 0;
    return this;
  }

  /** @param {string} name */
  place(name) {
    let place = this.places.get(name);
    if (place === undefined) {
      place = this.gl.getUniformLocation(this.program, name);
      this.places.set(name, place);
    }
    return place;
  }

  /** @param {string} name @param {number} value */
  int(name, value) {
    this.gl.uniform1i(this.place(name), value);
    return this;
  }

  /** @param {string} name @param {ArrayLike<number> | number} value one to four numbers */
  float(name, value) {
    const { gl } = this;
    const v = typeof value === "number" ? [value] : Array.from(value);
    const place = this.place(name);
    if (v.length === 1) gl.uniform1f(place, v[0]);
    else if (v.length === 2) gl.uniform2f(place, v[0], v[1]);
    else if (v.length === 3) gl.uniform3f(place, v[0], v[1], v[2]);
    else gl.uniform4f(place, v[0], v[1], v[2], v[3]);
    return this;
  }

  /** @param {string} name @param {Float32Array} values a multiple of four numbers */
  vec4s(name, values) {
    if (values.length) this.gl.uniform4fv(this.place(name), values);
    return this;
  }

  /** @param {string} name @param {ArrayLike<number>} columns nine numbers */
  mat3(name, columns) {
    this.gl.uniformMatrix3fv(this.place(name), false, Float32Array.from(columns));
    return this;
  }

  /** @param {string} name @param {Texture} texture */
  texture(name, texture) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + this.unit);
    gl.bindTexture(texture.target, texture.texture);
    gl.uniform1i(this.place(name), this.unit++);
    return this;
  }
}

/** Formats that are used here: internal format, format, type. @param {GL} gl */
export const formats = (gl) => ({
  rgba32f: [gl.RGBA32F, gl.RGBA, gl.FLOAT],
  rgba16f: [gl.RGBA16F, gl.RGBA, gl.HALF_FLOAT],
  r16f: [gl.R16F, gl.RED, gl.HALF_FLOAT],
  r32f: [gl.R32F, gl.RED, gl.FLOAT],
  r32i: [gl.R32I, gl.RED_INTEGER, gl.INT],
  r32ui: [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT],
  r8ui: [gl.R8UI, gl.RED_INTEGER, gl.UNSIGNED_BYTE],
  rgba8i: [gl.RGBA8I, gl.RGBA_INTEGER, gl.BYTE],
  rgba16i: [gl.RGBA16I, gl.RGBA_INTEGER, gl.SHORT],
  rgba8: [gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE],
});

/** @typedef {keyof ReturnType<typeof formats>} Format */

/** Immutable storage, or an array of layers when `layers` is given. */
export class Texture {
  /** @param {GL} gl @param {Format} format @param {number} width @param {number} height @param {{layers?: number, linear?: boolean}} [options] */
  constructor(gl, format, width, height, { layers = 0, linear = false } = {}) {
    this.gl = gl;
    this.width = width;
    this.height = height;
    this.target = layers ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D;
    this.format = formats(gl)[format];
    this.channels = format.startsWith("rgba") ? 4 : 1;
    this.texture = gl.createTexture();
    this.bind();
    const filter = linear ? gl.LINEAR : gl.NEAREST;
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ]) gl.texParameteri(this.target, name, value);
    if (layers) gl.texStorage3D(this.target, 1, this.format[0], width, height, layers);
    else gl.texStorage2D(this.target, 1, this.format[0], width, height);
  }

  bind() {
    // A unit that programs do not count up to, so that uploads never disturb what a program has bound.
    this.gl.activeTexture(this.gl.TEXTURE0 + 15);
    this.gl.bindTexture(this.target, this.texture);
    this.gl.pixelStorei(this.gl.UNPACK_ALIGNMENT, 1);
  }

  /** Write whole rows from `row` on. @param {ArrayBufferView} data @param {number} row @param {number} rows @param {number} [layer] */
  rows(data, row, rows, layer = 0) {
    const { gl } = this;
    this.bind();
    if (this.target === gl.TEXTURE_2D_ARRAY) {
      gl.texSubImage3D(this.target, 0, 0, row, layer, this.width, rows, 1, this.format[1], this.format[2], data);
    } else {
      gl.texSubImage2D(this.target, 0, 0, row, this.width, rows, this.format[1], this.format[2], data);
    }
  }

  delete() {
    this.gl.deleteTexture(this.texture);
  }
}

export class Target {
  /**
   * @param {GL} gl @param {number} width @param {number} height @param {Format[]} colors
   * @param {boolean | Target} depth of its own, or that of another target of the same size
   */
  constructor(gl, width, height, colors, depth) {
    this.gl = gl;
    this.width = width;
    this.height = height;
    this.framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    this.colors = colors.map((format, k) => {
      const texture = new Texture(gl, format, width, height, { linear: format.endsWith("16f") });
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, texture.texture, 0);
      return texture;
    });
    gl.drawBuffers(colors.map((_, k) => gl.COLOR_ATTACHMENT0 + k));
    /** @type {WebGLRenderbuffer | null} */
    this.depth = null;
    if (depth instanceof Target) {
      this.depth = depth.depth;
    } else if (depth) {
      this.depth = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, this.depth);
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT32F, width, height);
    }
    if (this.depth) gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, this.depth);
    const status = gl.checkFramebufferStatus(gl.FRAMEBUFFER);
    if (status !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost()) {
      throw new GraphicsError(`this browser cannot draw into ${colors.join(" + ")} of ${width}x${height} (0x${status.toString(16)})`);
    }
  }

  /** Draw here. @param {number} [width] @param {number} [height] of the lower left part that is drawn to */
  bind(width = this.width, height = this.height) {
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, this.framebuffer);
    this.gl.viewport(0, 0, width, height);
  }

  delete() {
    for (const texture of this.colors) texture.delete();
    this.gl.deleteRenderbuffer(this.depth);
    this.gl.deleteFramebuffer(this.framebuffer);
  }
}

/** An unsigned-integer target read back without stalling the graphics processor: pixel buffer and fence. */
export class Readback {
  /** @param {GL} gl */
  constructor(gl) {
    this.gl = gl;
    this.buffer = gl.createBuffer();
    /** @type {WebGLSync | null} */
    this.fence = null;
    this.size = 0;
    this.stride = 4;
    /** @type {any} */
    this.tag = null;
    this.data = new Uint32Array(0);
  }

  get pending() {
    return this.fence !== null;
  }

  /** Start to read the lower left part of the bound framebuffer. @param {number} width @param {number} height @param {any} tag handed back with the result */
  start(width, height, tag) {
    const { gl } = this;
    // One channel where the driver says it can; all four are guaranteed.
    const single = gl.getParameter(gl.IMPLEMENTATION_COLOR_READ_FORMAT) === gl.RED_INTEGER
      && gl.getParameter(gl.IMPLEMENTATION_COLOR_READ_TYPE) === gl.UNSIGNED_INT;
    this.stride = single ? 1 : 4;
    const count = width * height * this.stride;
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    if (count !== this.size) {
      gl.bufferData(gl.PIXEL_PACK_BUFFER, count * 4, gl.STREAM_READ);
      this.data = new Uint32Array(count);
      this.size = count;
    }
    gl.readPixels(0, 0, width, height, single ? gl.RED_INTEGER : gl.RGBA_INTEGER, gl.UNSIGNED_INT, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.tag = tag;
    gl.flush();
  }

  /** Hand over the result once it is there. @returns {{data: Uint32Array, stride: number, tag: any} | null} */
  poll() {
    const { gl } = this;
    if (this.fence === null || !signalled(gl, this.fence)) return null;
    gl.deleteSync(this.fence);
    this.fence = null;
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, this.data);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    return { data: this.data, stride: this.stride, tag: this.tag };
  }
}

/** @param {GL} gl @param {WebGLSync} fence */
export const signalled = (gl, fence) =>
  gl.isContextLost() || gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.SIGNALED;
