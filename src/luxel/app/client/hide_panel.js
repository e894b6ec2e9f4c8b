// The controls that hide particles: one cut plane and one range of a scalar. Conditions beyond these, as from Python, are kept.

import { label } from "./colors.js";
import { extent } from "./hiding.js";
import { fill, finder } from "./dom.js";

/** @typedef {import("./hiding.js").Condition} Condition */
/** @typedef {import("./hiding.js").Cut} Cut */
/** @typedef {import("./hiding.js").Select} Select */
/** @typedef {{keeps: Condition[], opens: Condition[]}} Conditions by what they do to light */

const STEPS = 400; // of a slider
const AXES = /** @type {Record<string, number[]>} */ ({
  x: [1, 0, 0], "-x": [-1, 0, 0], y: [0, 1, 0], "-y": [0, -1, 0], z: [0, 0, 1], "-z": [0, 0, -1],
});

/** @param {number} value @param {number} span */
const rounded = (value, span) => Number(value.toFixed(Math.max(0, Math.min(20, 4 - Math.floor(Math.log10(span || 1))))));

export class HidePanel {
  /**
   * @param {HTMLElement} root
   * @param {{hide: (conditions: Conditions) => void, towardsMe: () => number[], rangeOf: (name: string) => [number, number] | null}} host
   */
  constructor(root, host) {
    this.element = finder(root);
    this.host = host;
    /** @type {any} */
    this.scene = null;
    /** @type {Cut | null} */
    this.cut = null;
    /** @type {Select | null} */
    this.select = null;
    this.opens = { cut: true, select: true };
    /** What other conditions there are. @type {Conditions} */
    this.others = { keeps: [], opens: [] };
    const on = (/** @type {string} */ id, /** @type {string} */ type, /** @type {(input: HTMLInputElement) => void} */ action) => {
      const input = this.element(id);
      input.addEventListener(type, () => action(input));
    };
    on("cut", "change", (input) => this.chooseCut(input.value));
    on("cut-at", "change", (input) => this.moveCut(input.valueAsNumber));
    on("cut-slider", "input", (input) => {
      const [low, high] = this.ends();
      this.moveCut(rounded(low + (input.valueAsNumber / STEPS) * (high - low), high - low));
    });
    on("select", "change", (input) => this.chooseScalar(input.value));
    on("select-label", "change", (input) => this.setRange(Number(input.value), Number(input.value)));
    for (const end of /** @type {const} */ (["low", "high"])) {
      on(`select-${end}`, "change", (input) => this.moveEnd(end, input.value === "" ? null : input.valueAsNumber));
      on(`${end}-slider`, "input", (input) => {
        const [low, high] = this.range() ?? [0, 1];
        const at = input.valueAsNumber;
        const open = at === (end === "low" ? 0 : STEPS);
        this.moveEnd(end, open ? null : rounded(low + (at / STEPS) * (high - low), high - low));
      });
    }
    for (const which of /** @type {const} */ (["cut", "select"])) {
      on(`${which}-light`, "change", (input) => { this.opens[which] = input.value === "opens"; this.tell(); });
    }
    on("show-all", "click", () => {
      this.cut = this.select = null;
      this.others = { keeps: [], opens: [] };
      this.tell();
    });
  }

  /** @param {any} scene */
  setScene(scene) {
    this.scene = scene;
    const names = scene.scalars.map((/** @type {any} */ each) => [each.name, each.name]);
    fill(this.element("select"), [["", "everything"], ...names]);
    for (const which of /** @type {const} */ (["cut", "select"])) {
      const light = this.element(`${which}-light`);
      if (scene.light_fixed) this.opens[which] = false;
      light.disabled = scene.light_fixed;
      light.title = scene.light_fixed ? "The light is baked in" : "";
    }
    this.show();
  }

  /** Take over conditions that came from elsewhere. @param {Conditions} conditions */
  take({ keeps, opens }) {
    const find = (/** @type {string} */ kind) => opens.find((each) => each.kind === kind) ?? keeps.find((each) => each.kind === kind) ?? null;
    this.cut = /** @type {Cut | null} */ (find("cut"));
    this.select = /** @type {Select | null} */ (find("select"));
    if (this.cut) this.opens.cut = opens.includes(this.cut);
    if (this.select) this.opens.select = opens.includes(this.select);
    const rest = (/** @type {Condition[]} */ list) => list.filter((each) => each !== this.cut && each !== this.select);
    this.others = { keeps: rest(keeps), opens: rest(opens) };
    this.show();
  }

  /** @returns {Conditions} */
  get conditions() {
    const found = { keeps: [...this.others.keeps], opens: [...this.others.opens] };
    if (this.cut) (this.opens.cut ? found.opens : found.keeps).push(this.cut);
    if (this.select) (this.opens.select ? found.opens : found.keeps).push(this.select);
    return found;
  }

  tell() {
    this.show();
    this.host.hide(this.conditions);
  }

  /** @param {string} choice */
  chooseCut(choice) {
    const before = this.cut;
    if (choice === "") this.cut = null;
    else if (choice !== "free") {
      const normal = AXES[choice] ?? this.host.towardsMe();
      const [low, high] = extent(this.scene, normal);
      this.cut = { kind: "cut", normal, offset: rounded((low + high) / 2, high - low) };
    }
    if (this.cut !== before) this.tell();
  }

  /** Whether the plane's place is shown as a coordinate of an axis that the normal points against. */
  get flipped() {
    return this.cut !== null && this.axis().startsWith("-");
  }

  /** @returns {string} the choice that stands for the plane's direction */
  axis() {
    const { cut } = this;
    if (cut === null) return "";
    return Object.keys(AXES).find((name) => AXES[name].every((n, k) => Math.abs(n - cut.normal[k]) < 1e-9)) ?? "free";
  }

  /** @returns {[number, number]} where the slider begins and ends */
  ends() {
    if (this.cut === null) return [0, 1];
    const [low, high] = extent(this.scene, this.cut.normal);
    return this.flipped ? [-high, -low] : [low, high];
  }

  /** @param {number} at as it is shown */
  moveCut(at) {
    if (this.cut === null || !Number.isFinite(at)) return this.show();
    this.cut = { ...this.cut, offset: this.flipped ? -at : at };
    this.tell();
  }

  /** @param {string} name */
  chooseScalar(name) {
    const labels = this.labels(name);
    this.select = name === "" ? null : { kind: "select", scalar: name, low: labels ? 0 : null, high: labels ? 0 : null };
    this.tell();
  }

  /** @param {string | undefined} name @returns {string[] | null} */
  labels(name) {
    return this.scene.scalars.find((/** @type {any} */ each) => each.name === name)?.labels ?? null;
  }

  /** The values there are, once they have come. @returns {[number, number] | null} */
  range() {
    return this.select && this.host.rangeOf(this.select.scalar);
  }

  /** @param {"low" | "high"} end @param {number | null} value */
  moveEnd(end, value) {
    if (this.select === null || Number.isNaN(value)) return this.show();
    let [low, high] = end === "low" ? [value, this.select.high] : [this.select.low, value];
    // One end takes the other along.
    if (low !== null && high !== null && low > high) {
      if (end === "low") high = low;
      else low = high;
    }
    this.setRange(low, high);
  }

  /** @param {number | null} low @param {number | null} high */
  setRange(low, high) {
    if (this.select === null) return;
    this.select = { ...this.select, low, high };
    this.tell();
  }

  /** @param {number} hidden @param {number} count */
  showCount(hidden, count) {
    this.element("hiding").hidden = hidden === 0 && this.cut === null && this.select === null;
    this.element("hidden-count").textContent = count === 0 ? "" : `${hidden.toLocaleString("en")} of ${count.toLocaleString("en")} hidden`;
  }

  /** Bring the controls in line. */
  show() {
    if (this.scene === null) return;
    const { cut, select } = this;
    const set = (/** @type {string} */ id, /** @type {string} */ value) => {
      const input = this.element(id);
      if (input.value !== value) input.value = value;
    };
    const part = this.element("particles-part");
    part.classList.toggle("cuts", cut !== null);
    part.classList.toggle("selects", select !== null);
    this.element("cut").querySelector("[value=free]")?.toggleAttribute("hidden", this.axis() !== "free");
    set("cut", this.axis());
    set("cut-light", this.opens.cut ? "opens" : "keeps");
    set("select-light", this.opens.select ? "opens" : "keeps");
    if (cut) {
      const at = this.flipped ? -cut.offset : cut.offset;
      const [low, high] = this.ends();
      set("cut-at", String(at));
      this.element("cut-at").step = String(rounded((high - low) / 100, high - low) || "any");
      set("cut-slider", String(Math.round(((at - low) / (high - low || 1)) * STEPS)));
      this.element("cut-slider").setAttribute("aria-valuetext", String(at));
    }
    set("select", select?.scalar ?? "");
    if (select) this.showSelection(select, set);
  }

  /** @param {Select} select @param {(id: string, value: string) => void} set */
  showSelection({ scalar, low, high }, set) {
    const labels = this.labels(scalar);
    const one = labels !== null && low !== null && low === high;
    this.element("particles-part").classList.toggle("labels", one);
    if (labels && one) {
      fill(this.element("select-label"), labels.map((text, k) => [String(k), text]));
      set("select-label", String(low));
    }
    const [first, last] = this.range() ?? [0, 1];
    const text = (/** @type {number | null} */ value, /** @type {number} */ end) => String(value ?? Number(end.toPrecision(6)));
    const place = (/** @type {number} */ value) => String(Math.round(((value - first) / (last - first || 1)) * STEPS));
    set("select-low", text(low, first));
    set("select-high", text(high, last));
    set("low-slider", place(low ?? first));
    set("high-slider", place(high ?? last));
    this.element("low-slider").setAttribute("aria-valuetext", label(low ?? first, last - first));
    this.element("high-slider").setAttribute("aria-valuetext", label(high ?? last, last - first));
  }
}
