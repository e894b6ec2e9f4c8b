// The page that the server serves: the app over a socket, filling the window.

import { App } from "./app.js";
import { handle } from "./handle.js";
import { finder } from "./panel.js";
import { SocketTransport } from "./socket.js";

try {
  const app = new App(document.body, new SocketTransport(), { titled: (title) => { document.title = `${title} – luxel`; } });
  Object.assign(window, { luxel: handle(app) });
} catch (error) {
  const banner = finder(document.body)("banner");
  banner.textContent = error instanceof Error ? error.message : String(error);
  banner.hidden = false;
  throw error;
}
