// What stands in for the renderer where the browser cannot draw: it takes everything and shows nothing. The server draws then.

/** A light set that keeps nothing. */
class NoLightSet {
  setTiles() {}
  setBaked() {}
  upload() {}
}

/** The part of a Renderer that the app talks to. */
export class NoRenderer {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.name = "nothing";
    this.gl = { isContextLost: () => false, getExtension: () => null };
    this.look = {};
    this.sets = [new NoLightSet()];
    this.spheres = null; // with which a film has nothing to do
    this.targets = {};
    this.readback = { pending: false, poll: () => null };
    this.frames = [];
    this.times = new Map();
    this.busy = false;
    this.whole = { count: 0, ms: 0 };
    this.particlesMax = 0;
    this.swell = 1;
    this.frameMs = this.frameCount = this.count = this.loaded = 0;
  }

  setScene() {}
  setSpheres() {}
  setValues() {}
  setLut() {}
  resize() {}

  idAt() {
    return -1;
  }
}
