// The page that is a file (app/export.py writes it): the app over what lies in the page itself, with no server anywhere.

import { App } from "./app.js";
import { finder } from "./dom.js";
import { handle } from "./handle.js";
import { KIND, decode, encode } from "./protocol.js";
import { rowBytes, unpack } from "./unpacking.js";

/** @typedef {import("./transport.js").Transport} Transport */
/** @typedef {import("./unpacking.js").Packing} Packing */

/**
 * What the head of the data says.
 * @typedef {object} Head
 * @property {Packing} packing
 * @property {number} block particles in a block; the last has what is left
 * @property {number} record bytes of a texture, 0 where there are none
 * @property {string} key of the light
 * @property {number} epoch
 * @property {object} view what views say where they say nothing
 */

/** @implements {Transport} */
export class FileTransport {
  /** @param {Document} page */
  constructor(page) {
    this.page = page;
    this.connected = false;
    this.live = false;
    /** @type {Transport["onmessage"]} */
    this.onmessage = null;
    /** @type {Transport["onopen"]} */
    this.onopen = null;
    /** @type {Transport["ontrouble"]} */
    this.ontrouble = null;
    /** @type {Head | null} */
    this.head = null;
    /** @type {Map<string, Float32Array>} */
    this.values = new Map();
    /** @type {Map<string, ArrayBuffer>} */
    this.colormaps = new Map();
    /** Ids in the file that was exported, of the particles here. @type {Uint32Array | null} */
    this.ids = null;
    /** Done when all is unpacked. @type {Promise<void>} */
    this.loaded = Promise.resolve();
  }

  open() {
    this.loaded = this.load();
    this.loaded.catch((error) => this.ontrouble?.(`This page cannot be shown: ${error instanceof Error ? error.message : error}`));
  }

  close() {
    this.connected = false;
  }

  async load() {
    if (!("DecompressionStream" in window)) throw new Error("this browser is too old to unpack it; use a newer one");
    const [head] = this.take("head");
    const parts = split(await inflate(head));
    const about = /** @type {Head} */ (JSON.parse(new TextDecoder().decode(parts[0])));
    this.head = about;
    const first = [];
    for (const part of parts.slice(1)) {
      const { kind, head: { name } } = decode(part);
      if (kind === KIND.colormap) this.colormaps.set(name, part);
      else first.push(part);
    }
    this.connected = true;
    this.onopen?.();
    for (const part of first) this.onmessage?.(part); // what this makes the app ask for is there by now
    const { packing, record, block, key, epoch } = about;
    for (const { name } of packing.scalars) this.values.set(name, new Float32Array(packing.count));
    if (packing.ids) this.ids = new Uint32Array(packing.count);
    let start = 0;
    for (const text of this.take("block")) {
      const count = Math.min(block, packing.count - start);
      const data = await inflate(text);
      const columns = rowBytes(packing) * count;
      if (data.length !== columns + record * count) throw new Error("its data is damaged");
      const { positions, radii, scalars, ids } = unpack(packing, data, count);
      packing.scalars.forEach(({ name }, k) => this.values.get(name)?.set(scalars[k], start));
      if (ids) this.ids?.set(ids, start);
      this.onmessage?.(encode(KIND.geometry, { epoch, start }, { positions, radii }));
      if (record) this.onmessage?.(encode(KIND.payload, { key, start }, { records: data.subarray(columns) }));
      start += count;
    }
    if (start !== packing.count) throw new Error("a part of its data is missing");
  }

  /** Texts of a kind, which are taken out of the page: it needs them once. @param {string} kind */
  take(kind) {
    return [...this.page.querySelectorAll(`script[data-luxel="${kind}"]`)].map((element) => {
      element.remove();
      return element.textContent ?? "";
    });
  }

  /** Answer as a server would. @param {ArrayBuffer} message */
  send(message) {
    const { kind, head } = decode(message);
    if (kind === KIND.colormapRequest) {
      const found = this.colormaps.get(head.name);
      if (found) this.later(found);
    } else if (kind === KIND.scalarRequest) {
      this.loaded.then(() => this.sendScalar(head.name), () => {});
    } else if (kind === KIND.loadView) {
      this.later(encode(KIND.view, { view: { ...this.head?.view, ...(head.saved.view ?? head.saved) } }));
    } else if (kind === KIND.setLight || kind === KIND.setFrame) {
      this.later(encode(KIND.error, { text: "The light of this page is fixed: there is no luxel behind it that could compute another." }));
    }
  }

  /** @param {string} name */
  sendScalar(name) {
    const about = this.head?.packing.scalars.find((each) => each.name === name);
    const values = this.values.get(name);
    if (about && values) {
      const { range, log_range, whole } = about;
      this.onmessage?.(encode(KIND.scalar, { epoch: this.head?.epoch, name, range, log_range, whole }, { values }));
    } else {
      this.onmessage?.(encode(KIND.error, { text: `This page does not hold ${name}: export it again with --scalars ${name}.` }));
    }
  }

  /** Never from within a call of the app. @param {ArrayBuffer} message */
  later(message) {
    queueMicrotask(() => this.onmessage?.(message));
  }
}

/** @param {string} text base64 of what was packed @returns {Promise<Uint8Array>} */
async function inflate(text) {
  const packed = atob(text);
  const bytes = new Uint8Array(packed.length);
  for (let k = 0; k < bytes.length; k++) bytes[k] = packed.charCodeAt(k);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Parts, each after its length. @param {Uint8Array} data @returns {ArrayBuffer[]} */
function split(data) {
  const view = new DataView(data.buffer);
  const parts = [];
  for (let at = 0; at < data.length;) {
    const size = view.getUint32(at, true);
    parts.push(/** @type {ArrayBuffer} */ (data.buffer).slice(at + 4, at + 4 + size));
    at += 4 + size;
  }
  return parts;
}

try {
  const connection = new FileTransport(document);
  const app = new App(document.body, connection, { titled: (title) => { document.title = `${title} – luxel`; } });
  Object.assign(window, { luxel: handle(app) });
} catch (error) {
  const banner = finder(document.body)("banner");
  banner.textContent = error instanceof Error ? error.message : String(error);
  banner.hidden = false;
  throw error;
}
