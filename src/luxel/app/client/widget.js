// The app inside a notebook's cell, over the channel that the notebook keeps to its kernel; app/comm.py is the other end.

import { App } from "./app.js";
import { handle } from "./handle.js";
import { SUBPROTOCOL } from "./protocol.js";

/** @typedef {import("./transport.js").Transport} Transport */
/** @typedef {{page: string, do: string, text?: string}} Content */

/**
 * What anywidget hands out, as far as it is used here.
 * @typedef {object} Model
 * @property {(name: string) => any} get
 * @property {(event: string, action: (...values: any[]) => void) => void} on
 * @property {(event: string, action: (...values: any[]) => void) => void} off
 * @property {(content: object, callbacks?: undefined, buffers?: ArrayBuffer[]) => void} send
 */

const PATIENCE_MS = 4000;
const NARROW = 700; // pixels; the panel would leave little of the picture

/** @implements {Transport} */
export class CommTransport {
  /** @param {Model} model */
  constructor(model) {
    this.model = model;
    this.page = crypto.getRandomValues(new Uint32Array(4)).join("-"); // randomUUID wants a secure context
    this.connected = false;
    this.live = true;
    this.timer = 0;
    /** @type {Transport["onmessage"]} */
    this.onmessage = null;
    /** @type {Transport["onopen"]} */
    this.onopen = null;
    /** @type {Transport["ontrouble"]} */
    this.ontrouble = null;
    this.hear = (/** @type {Content} */ content, /** @type {(DataView | ArrayBuffer)[]} */ buffers) => this.take(content, buffers);
    this.lost = () => this.end("The kernel has ended or was restarted: run the cell again.");
  }

  open() {
    this.model.on("msg:custom", this.hear);
    this.model.on("comm:close", this.lost);
    this.tell("open", { version: SUBPROTOCOL });
    this.ping();
  }

  close() {
    this.model.off("msg:custom", this.hear);
    this.model.off("comm:close", this.lost);
    if (this.connected) this.tell("close");
    this.connected = false;
    clearTimeout(this.timer);
  }

  /** @param {ArrayBuffer} message */
  send(message) {
    if (!this.connected) return;
    this.tell("message", {}, [message]);
    this.ping();
  }

  /** @param {string} what @param {object} [more] @param {ArrayBuffer[]} [buffers] */
  tell(what, more = {}, buffers = []) {
    try {
      this.model.send({ page: this.page, do: what, ...more }, undefined, buffers);
    } catch {
      this.lost(); // JupyterLab throws once the kernel that made the widget is gone
    }
  }

  /** Find out whether the kernel answers: while it runs a cell, it does not. */
  ping() {
    if (this.timer) return;
    this.tell("ping");
    if (this.timer) return; // the kernel is gone
    this.timer = setTimeout(() => this.ontrouble?.("Waiting for the kernel: it runs a cell, or has ended.", true), PATIENCE_MS);
  }

  /** @param {Content} content @param {(DataView | ArrayBuffer)[]} buffers */
  take(content, buffers) {
    if (content.page !== this.page) return;
    if (content.do === "message") {
      const [data] = buffers;
      // A view may start anywhere in the frame it came in; arrays must start at a multiple of four.
      this.onmessage?.(data instanceof ArrayBuffer ? data : /** @type {ArrayBuffer} */ (data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength)));
    } else if (content.do === "opened") {
      this.connected = true;
      this.onopen?.();
    } else if (content.do === "pong") {
      clearTimeout(this.timer);
      this.timer = 0;
      this.ontrouble?.(null);
    } else if (content.do === "end") {
      this.end(content.text ?? "The kernel let this view go.");
    }
  }

  /** @param {string} why */
  end(why) {
    this.connected = false;
    clearTimeout(this.timer);
    this.timer = -1; // no more pings
    this.ontrouble?.(why);
  }
}

/** What the notebook's theme says: JupyterLab and Notebook, VS Code, then others. @returns {string} a value of color-scheme */
function scheme() {
  const { body, documentElement } = document;
  const { jpThemeLight, vscodeThemeKind } = body.dataset;
  if (jpThemeLight) return jpThemeLight === "true" ? "light" : "dark";
  if (vscodeThemeKind) return vscodeThemeKind.endsWith("light") ? "light" : "dark";
  const words = `${documentElement.className} ${body.className} ${documentElement.getAttribute("theme") ?? ""}`.split(/\s+/);
  return words.includes("dark") ? "dark" : words.includes("light") ? "light" : "light dark";
}

/** @param {{model: Model, el: HTMLElement}} cell */
function render({ model, el }) {
  const host = document.createElement("div");
  host.className = "luxel-widget";
  // Letters are ours while the picture has the focus: JupyterLab would cut cells at an x.
  host.dataset.lmSuppressShortcuts = "true";
  for (const name of ["keydown", "contextmenu"]) host.addEventListener(name, (event) => event.stopPropagation());
  Object.assign(host.style, { width: "100%", height: `${model.get("height")}px`, minHeight: "120px", resize: "vertical", overflow: "hidden" });
  const shadow = host.attachShadow({ mode: "open" });
  const style = new CSSStyleSheet();
  style.replaceSync(model.get("_style"));
  shadow.adoptedStyleSheets = [style];
  const root = document.createElement("div");
  root.className = "luxel";
  root.innerHTML = model.get("_markup");
  shadow.append(root);
  el.append(host);

  const themes = new MutationObserver(() => { root.style.colorScheme = scheme(); });
  for (const each of [document.body, document.documentElement]) themes.observe(each, { attributes: true });
  root.style.colorScheme = scheme();
  const resize = () => { host.style.height = `${model.get("height")}px`; };
  model.on("change:height", resize);

  /** @type {App | null} */
  let app = null;
  try {
    app = new App(root, new CommTransport(model));
    Object.assign(host, { luxel: handle(app) });
    const { panel } = app;
    new ResizeObserver(([{ contentRect }], observer) => {
      if (contentRect.width === 0) return; // not in the page yet
      observer.disconnect();
      if (contentRect.width < NARROW) panel.fold();
    }).observe(host);
  } catch (error) {
    const banner = /** @type {HTMLElement} */ (root.querySelector("#banner"));
    banner.textContent = error instanceof Error ? error.message : String(error);
    banner.hidden = false;
  }
  return () => {
    app?.close();
    themes.disconnect();
    model.off("change:height", resize);
  };
}

export const widget = { render };
