// The connection of the served page: opens, re-opens, hands messages on, and says what went wrong in words.

import { SUBPROTOCOL } from "./protocol.js";

/** Close codes after which trying again is no use. */
const FINAL = new Map([
  [4400, "The server refused a message"],
  [4401, "Not authorised"],
  [4406, "Page and server are of different versions"],
  [4429, "The server is full"],
]);
const RETRY_MS = [300, 1000, 2000, 5000];

/** @typedef {import("./transport.js").Transport} Transport */

/** @implements {Transport} */
export class SocketTransport {
  constructor() {
    this.attempts = 0;
    this.live = true;
    /** @type {Transport["onmessage"]} */
    this.onmessage = null;
    /** @type {Transport["onopen"]} */
    this.onopen = null;
    /** @type {Transport["ontrouble"]} */
    this.ontrouble = null;
    /** @type {WebSocket | null} */
    this.socket = null;
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}/ws${location.search}`, SUBPROTOCOL);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.attempts = 0;
      this.ontrouble?.(null);
      this.onopen?.();
    };
    socket.onmessage = (event) => {
      if (this.socket === socket) this.onmessage?.(event.data);
    };
    socket.onclose = (event) => {
      if (this.socket !== socket) return;
      this.socket = null;
      const known = FINAL.get(event.code);
      if (known !== undefined) {
        this.ontrouble?.(`${known}: ${event.reason}`);
        return;
      }
      this.ontrouble?.("Disconnected from the server — trying again …");
      setTimeout(() => this.open(), RETRY_MS[Math.min(this.attempts++, RETRY_MS.length - 1)]);
    };
    this.socket = socket;
  }

  close() {
    const { socket } = this;
    this.socket = null;
    socket?.close();
  }

  get connected() {
    return this.socket !== null && this.socket.readyState === WebSocket.OPEN;
  }

  /** @param {ArrayBuffer} message */
  send(message) {
    if (this.connected) /** @type {WebSocket} */ (this.socket).send(message);
  }
}
