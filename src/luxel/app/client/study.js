// A small testbed for perceptual studies: views under shading models in random order, a question about each, timed answers as CSV.

import { download } from "./dom.js";
import { MODEL_NAMES } from "./panel.js";

/** @typedef {import("./app.js").App} App */
/** @typedef {{view: number, model: string}} Trial */

const SAMPLES = 4; // a picture that is shown is at least so smooth

/** Numbers 0..1 from a seed (mulberry32): a study can be run again in the same order. @param {number} seed */
export function random(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = state;
    t = Math.imul(t ^ (t >>> 15), t | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

/** All pairs of a view and a model in random order. @param {number} views @param {string[]} models @param {number} seed @returns {Trial[]} */
export function trials(views, models, seed) {
  const all = Array.from({ length: views }, (_, view) => models.map((model) => ({ view, model }))).flat();
  const next = random(seed);
  for (let k = all.length - 1; k > 0; k--) {
    const other = Math.floor(next() * (k + 1));
    [all[k], all[other]] = [all[other], all[k]];
  }
  return all;
}

/** @param {(string | number)[][]} rows */
export function csv(rows) {
  const cell = (/** @type {string | number} */ value) => {
    const text = String(value);
    return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return rows.map((row) => `${row.map(cell).join(",")}\r\n`).join("");
}

export class Study {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** Saved views, and what the answers call them. @type {{name: string, saved: any}[]} */
    this.views = [];
    /** @type {{seed: number, question: string, answers: string[], order: Trial[], rows: (string | number)[][], before: any, beside: string} | null} */
    this.run = null;
    /** When the picture of this trial appeared; null while it is prepared. @type {number | null} */
    this.shownAt = null;
    /** Whether the server has taken on the view of this trial. */
    this.loaded = false;
    const { element } = app;
    element("study-add").addEventListener("click", () => this.add());
    const files = element("study-files");
    element("study-load").addEventListener("click", () => files.click());
    files.addEventListener("change", () => this.addFiles([...(files.files ?? [])]).then(() => { files.value = ""; }));
    element("study-clear").addEventListener("click", () => { this.views = []; this.show(); });
    element("study-start").addEventListener("click", () => this.start());
    app.root.addEventListener("keydown", (event) => this.key(event), { capture: true });
    element("study-seed").value = String(crypto.getRandomValues(new Uint32Array(1))[0]);
    this.show();
  }

  /** Bring the list of models in line with the scene. */
  offer() {
    const { scene, light, remote } = this.app;
    const list = this.app.element("study-models");
    const [legend] = list.children;
    const baked = remote.active ? [light.state.model] : [...new Set([light.state.model, "lambertian"])];
    const models = scene.light_fixed ? baked : scene.models;
    if (list.dataset.models === String(models)) return;
    list.dataset.models = String(models);
    list.replaceChildren(legend, ...models.map((/** @type {string} */ name) => {
      const label = document.createElement("label"), box = document.createElement("input");
      Object.assign(box, { type: "checkbox", value: name, checked: true });
      label.append(box, ` ${MODEL_NAMES[name] ?? name}`);
      return label;
    }));
  }

  add() {
    if (this.app.scene === null || this.app.light.state === null) return;
    this.views.push({ name: String(this.views.length + 1), saved: this.app.saved.current });
    this.show();
  }

  /** @param {File[]} files of saved views */
  async addFiles(files) {
    for (const file of files) {
      /** @type {any} */
      let saved = null;
      try {
        saved = JSON.parse(await file.text());
      } catch {
        // told below
      }
      if (typeof saved === "object" && saved !== null && "luxel_view" in saved) this.views.push({ name: file.name, saved });
      else this.app.notices.trouble("study", `${file.name} is no saved view`, true);
    }
    this.show();
  }

  show() {
    const n = this.views.length;
    this.app.element("study-views").textContent = n === 0 ? "No views yet" : n === 1 ? "1 view" : `${n} views`;
    this.app.element("study-start").disabled = n === 0;
  }

  start() {
    const { element, saved, root, notices, drawing, beside, player } = this.app;
    const models = [...element("study-models").querySelectorAll("input")].filter((box) => box.checked).map((box) => box.value);
    const answers = element("study-answers").value.split(",").map((text) => text.trim()).filter((text) => text !== "").slice(0, 9);
    const seed = element("study-seed").valueAsNumber;
    const wrong = this.views.length === 0 ? "Add views first" : models.length === 0 ? "Choose shading models"
      : answers.length < 2 ? "Give two answers at least, with commas between them" : !(seed >= 0 && seed < 2 ** 32) ? "The seed must be a whole number below 2³²" : null;
    if (wrong !== null) return notices.trouble("study", wrong, true);
    this.run = {
      seed, question: element("study-question").value, answers, order: trials(this.views.length, models, seed), before: saved.current, beside: beside.model,
      rows: [["seed", "trial", "view", "model", "question", "answer", "seconds"]],
    };
    player.stop();
    beside.choose("");
    root.classList.add("studying");
    element("trial-question").textContent = this.run.question;
    element("trial-answers").replaceChildren(...answers.map((text, k) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = `${k + 1}  ${text}`;
      button.addEventListener("click", () => this.answer(k));
      return button;
    }));
    element("trial").hidden = false;
    element("trial").focus({ preventScroll: true }); // so that keys come here, in a notebook too
    drawing.resize();
    this.prepare();
  }

  /** @returns {Trial} the trial now */
  get trial() {
    const { order, rows } = /** @type {NonNullable<typeof this.run>} */ (this.run);
    return order[rows.length - 1];
  }

  /** Take the next picture on, behind a curtain. */
  prepare() {
    const { element, scene, beside } = this.app;
    const { view, model } = this.trial;
    const { order, rows, before } = /** @type {NonNullable<typeof this.run>} */ (this.run);
    this.shownAt = null;
    this.loaded = false;
    element("curtain").hidden = false;
    element("curtain").textContent = `Picture ${rows.length} of ${order.length} …`;
    for (const button of element("trial-answers").querySelectorAll("button")) button.disabled = true;
    const { saved } = this.views[view];
    if (scene.light_fixed) {
      const other = model !== this.app.light.state.model;
      beside.choose(other ? model : "");
      beside.divider.move(other ? 0 : 0.5);
    }
    const light = scene.light_fixed ? null : { ...(saved.light ?? before.light), model };
    this.app.saved.load(JSON.stringify({ ...saved, light }));
  }

  /** The server has taken on a view. */
  viewTaken() {
    this.loaded = true;
    requestAnimationFrame(() => this.tick()); // where the server draws, and this is what it has drawn already, no picture comes
  }

  /** Something went wrong. */
  failed() {
    if (this.run !== null && !this.loaded) this.end(`View ${this.views[this.trial.view].name} cannot be shown`);
  }

  /** Whether the picture of this trial is complete. */
  get ready() {
    const { light, beside, coloring, spheres, arrival, remote, drawing: { film } } = this.app;
    const { model } = this.trial, { shown } = film;
    if (remote.active) return this.loaded && light.state.model === model && remote.current && remote.shown.final;
    const lit = () => {
      const other = beside.counts();
      const { visible, ready } = light.counts();
      if (other !== null) return other.model === model && other.ready >= visible;
      return light.state.model === model && (model === "lambertian" || ready >= visible);
    };
    return this.loaded && spheres.complete && (arrival.done || !arrival.active) && !coloring.waiting && film.centralKnown
      && shown !== null && shown.epoch === film.epoch && shown.light === film.light && shown.scale === 1 && !shown.culled && shown.count >= SAMPLES && lit();
  }

  /** Something was drawn. */
  tick() {
    if (this.run === null || this.shownAt !== null || !this.ready) return;
    this.shownAt = Infinity;
    const { element } = this.app;
    element("curtain").hidden = true;
    for (const button of element("trial-answers").querySelectorAll("button")) button.disabled = false;
    requestAnimationFrame(() => { this.shownAt = performance.now(); });
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (this.run === null || event.ctrlKey || event.metaKey || event.altKey) return;
    const digit = "123456789".indexOf(event.key);
    if (event.key === "Escape") this.end("The study was ended early");
    else if (event.key.length === 1 && digit >= 0) this.answer(digit);
    else if (event.key === "Tab" || event.key === "Enter" || event.key === " ") return;
    event.preventDefault();
    event.stopPropagation(); // the camera stays where it is
  }

  /** @param {number} k */
  answer(k) {
    const { run, shownAt } = this;
    if (run === null || shownAt === null || !Number.isFinite(shownAt) || k >= run.answers.length) return;
    const seconds = ((performance.now() - shownAt) / 1000).toFixed(3);
    const { view, model } = this.trial;
    run.rows.push([run.seed, run.rows.length, this.views[view].name, model, run.question, run.answers[k], seconds]);
    if (run.rows.length <= run.order.length) return this.prepare();
    this.end(null);
  }

  /** Hand the answers to the user, and go back to before. @param {string | null} why it ends early */
  end(why) {
    const { run } = this;
    if (run === null) return;
    const { element, root, saved, drawing, beside, notices } = this.app;
    this.run = null;
    root.classList.remove("studying");
    element("trial").hidden = element("curtain").hidden = true;
    if (this.app.scene.light_fixed) beside.divider.move(0.5);
    beside.choose(run.beside);
    saved.load(JSON.stringify(run.before));
    drawing.resize();
    const count = run.rows.length - 1;
    if (count > 0) download(new Blob([csv(run.rows)], { type: "text/csv" }), `study-${run.seed}.csv`);
    notices.trouble("study", `${why ?? "The study is done"}: ${count} of ${run.order.length} answers${count > 0 ? " saved" : ""}.`, true);
    element("study-seed").value = String(crypto.getRandomValues(new Uint32Array(1))[0]);
  }
}
