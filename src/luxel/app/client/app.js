// The app: wires connection, data, picture and controls together, inside one element of whatever page it is in.

import { Arrival } from "./arrival.js";
import { Beside } from "./beside.js";
import { Coloring } from "./coloring.js";
import { Controls } from "./controls.js";
import { finder } from "./dom.js";
import { Drawing, reach } from "./drawing.js";
import { Illumination } from "./illumination.js";
import { Notices } from "./notices.js";
import { Panel } from "./panel.js";
import { Pick } from "./pick.js";
import { Player } from "./player.js";
import { KIND, decode, encode } from "./protocol.js";
import { Remote } from "./remote.js";
import { SavedViews } from "./saved.js";
import { Screenshot } from "./screenshot.js";
import { Spheres } from "./spheres.js";
import { Study } from "./study.js";
import { Viewpoint } from "./viewpoint.js";
import { cameraFromFile } from "./views.js";

/** @typedef {import("./transport.js").Transport} Transport */

export class App {
  /**
   * @param {HTMLElement} root holds the markup of index.html
   * @param {Transport} connection
   * @param {{titled?: (title: string) => void}} [host] the page around
   */
  constructor(root, connection, host = {}) {
    this.root = root;
    this.element = finder(root);
    this.connection = connection;
    this.closing = new AbortController();
    /** The scene message. @type {any} */
    this.scene = null;
    // Each of these owns a part of what is shown, and finds the others here.
    this.notices = new Notices(this);
    this.viewpoint = new Viewpoint(this);
    this.coloring = new Coloring(this);
    this.light = new Illumination(this);
    this.spheres = new Spheres(this);
    this.arrival = new Arrival(this);
    this.saved = new SavedViews(this);
    this.panel = this.makePanel(host);
    this.remote = new Remote(this);
    this.screenshot = new Screenshot(this);
    this.drawing = new Drawing(this);
    this.beside = new Beside(this);
    this.player = new Player(this);
    this.study = new Study(this);
    this.pick = new Pick(root, {
      inspect: (id) => this.connection.send(encode(KIND.inspect, { id })),
      shown: () => this.spheres.shown,
      swell: () => this.drawing.renderer.swell,
      redraw: () => this.drawing.drawOverlay(),
    });
    new Controls(this.drawing.canvas, {
      get: () => this.viewpoint.camera,
      set: (camera) => this.viewpoint.set(camera),
      frame: () => this.viewpoint.fit(),
      axis: (axis, negative) => this.viewpoint.axisView(axis, negative),
      click: (x, y) => this.pickAt(x, y),
      escape: () => this.pick.set(-1),
    });
    connection.onmessage = (message) => this.receive(decode(message));
    connection.ontrouble = (trouble, mild = false) => {
      this.notices.trouble("connection", mild ? null : trouble);
      this.notices.trouble("waiting", mild ? trouble : null);
    };
    connection.onopen = () => {
      this.light.connected();
      this.remote.connected();
      this.screenshot.connected();
      this.introduce();
      this.beside.connected();
    };
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.coloring.drawBar(), { signal: this.closing.signal });
    this.drawing.resize();
    connection.open();
  }

  /** Say hello: the server tells everything then, and once more if it was said before. */
  introduce() {
    this.connection.send(encode(KIND.hello, { renderer: this.drawing.renderer.name.slice(0, 400), by: this.remote.by }));
  }

  /** @param {{titled?: (title: string) => void}} host */
  makePanel(host) {
    return new Panel(this.root, {
      color: () => this.coloring.changed(),
      tone: () => this.coloring.toneChanged(),
      light: (change) => this.light.send(change),
      frame: (frame) => this.askForFrame(frame),
      play: () => this.player.toggle(),
      step: (by) => this.player.step(by),
      fit: () => this.viewpoint.fit(),
      axis: (axis, negative) => this.viewpoint.axisView(axis, negative),
      projection: () => this.viewpoint.toggleProjection(),
      layout: () => this.drawing.resize(),
      titled: (title) => host.titled?.(title),
      up: () => this.viewpoint.upChanged(),
      radius: (scale) => this.spheres.scaleRadii(scale),
      hide: ({ keeps, opens }) => this.spheres.hideChanged(keeps, opens),
      towardsMe: () => this.viewpoint.towardsMe(),
      rangeOf: (name) => this.coloring.scalars.get(name)?.range ?? null,
      saveView: () => this.saved.save(),
      loadView: (text) => this.saved.load(text),
    });
  }

  /** Give everything back; the root may be thrown away then. */
  close() {
    this.closing.abort();
    this.light.close();
    this.player.stop();
    this.connection.onmessage = this.connection.onopen = this.connection.ontrouble = null;
    this.connection.close();
    // Browsers keep few graphics contexts, and collect those without owner late.
    this.drawing.renderer.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  /** @param {import("./protocol.js").Message} message */
  receive({ kind, head, arrays }) {
    switch (kind) {
      case KIND.scene: return this.takeScene(head);
      case KIND.light: return this.light.take(head, arrays);
      case KIND.geometry: return this.spheres.takeGeometry(head, arrays);
      case KIND.scalar: return this.coloring.takeScalar(head, arrays);
      case KIND.colormap: return this.coloring.takeColormap(head, arrays);
      case KIND.tiles: return this.light.takeTiles(head, arrays);
      case KIND.coarse: return this.light.takeCoarse(head, arrays);
      case KIND.codec: return this.light.takeCodec(head, arrays);
      case KIND.payload: return this.light.takePayload(head, arrays);
      case KIND.status: return this.notices.takeStatus(head);
      case KIND.error: return this.takeError(head.text);
      case KIND.beside: return this.beside.take(head, arrays);
      case KIND.view: return this.saved.take(head.view);
      case KIND.frame: return this.remote.take(head, arrays);
      case KIND.picked: return this.remote.takePicked(head);
      case KIND.screenshotState: return this.screenshot.takeState(head);
      case KIND.screenshotPart: return this.screenshot.takePart(head, arrays);
      case KIND.particle: return head.epoch === this.scene?.epoch && this.pick.take(head);
    }
  }

  /** @param {any} head */
  takeScene(head) {
    const again = this.scene !== null && this.scene.title === head.title;
    const { drawing, viewpoint } = this;
    this.remote.reset(head);
    this.scene = head;
    const held = this.arrival.reset(head); // particles that there will be room for here
    this.spheres.reset(held, this.light.state?.lighting.radius_scale ?? 1);
    this.coloring.reset();
    drawing.guard(() => drawing.renderer.setScene(held, reach(head), head.first ? head.count : 0));
    this.light.reset({ ...head, count: held });
    this.beside.reset({ ...head, count: held });
    this.player.take(head.frame);
    if (again) drawing.hold();
    // Where particles come part by part, numbers change with the time step.
    if (this.pick.id >= 0) this.pick.set(again && !head.first && this.pick.id < head.count ? this.pick.id : -1);
    this.panel.setScene(head, again);
    this.notices.trouble("notice", head.notice || null);
    if (!again || viewpoint.camera === null) {
      viewpoint.set(head.view.camera ? cameraFromFile(head.view.camera, head) : viewpoint.framed(viewpoint.firstDirection(), false));
    }
    this.spheres.applyHiding();
    drawing.film.restart();
    this.coloring.changed();
    this.coloring.toneChanged();
    this.arrival.next();
    this.notices.show();
  }

  /** @param {string} text */
  takeError(text) {
    this.notices.trouble("server", text, true);
    this.player.failed();
    this.study.failed();
  }

  /** Show another time step. @param {number} frame */
  askForFrame(frame) {
    this.connection.send(encode(KIND.setFrame, { frame }));
  }

  /** Write to the server's log. @param {string} text */
  report(text) {
    this.connection.send(encode(KIND.report, { text: text.slice(0, 3900) }));
  }

  /** Whether the server is still to be told of a change. */
  get pending() {
    return this.spheres.sendOpened.pending() || Object.values(this.panel.changes).some((change) => change.pending());
  }

  /** Tell about the particle at a point of the picture. @param {number} x fraction from the left @param {number} y from the top */
  pickAt(x, y) {
    const { camera } = this.viewpoint;
    if (camera === null || this.scene === null) return;
    if (this.remote.active) this.remote.pickAt(x, y);
    else this.pick.set(this.drawing.renderer.idAt(camera, x, 1 - y));
  }
}
