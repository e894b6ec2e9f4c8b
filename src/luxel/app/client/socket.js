// The connection: opens, re-opens, hands messages on, and says what went wrong in words.

import { SUBPROTOCOL, decode } from "./protocol.js";

/** Close codes after which trying again is no use. */
const FINAL = new Map([
  [4400, "The server refused a message"],
  [4401, "Not authorised"],
  [4406, "Page and server are of different versions"],
  [4429, "The server is full"],
]);
const RETRY_MS = [300, 1000, 2000, 5000];

export class Connection {
  /**
   * @param {(message: import("./protocol.js").Message) => void} onMessage
   * @param {() => void} onOpen
   * @param {(text: string | null, final: boolean) => void} onTrouble null means all is well again
   */
  constructor(onMessage, onOpen, onTrouble) {
    this.onMessage = onMessage;
    this.onOpen = onOpen;
    this.onTrouble = onTrouble;
    this.attempts = 0;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}/ws${location.search}`, SUBPROTOCOL);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.attempts = 0;
      this.onTrouble(null, false);
      this.onOpen();
    };
    socket.onmessage = (event) => {
      if (this.socket === socket) this.onMessage(decode(event.data));
    };
    socket.onclose = (event) => {
      if (this.socket !== socket) return;
      this.socket = null;
      const known = FINAL.get(event.code);
      if (known !== undefined) {
        this.onTrouble(`${known}: ${event.reason}`, true);
        return;
      }
      this.onTrouble("Disconnected from the server — trying again …", false);
      setTimeout(() => this.open(), RETRY_MS[Math.min(this.attempts++, RETRY_MS.length - 1)]);
    };
    this.socket = socket;
  }

  get connected() {
    return this.socket !== null && this.socket.readyState === WebSocket.OPEN;
  }

  /** @param {ArrayBuffer} message */
  send(message) {
    if (this.connected) /** @type {WebSocket} */ (this.socket).send(message);
  }
}
