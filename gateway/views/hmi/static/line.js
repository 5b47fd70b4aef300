// Frames from the server, by WebSocket.
//
// Rule: a lost connection is tried again for ever.  One on which nothing comes is lost, too: a network that was cut
// says nothing of it.

import { page, renew, server } from "./server.js";

const SILENT_S = 3, AGAIN_MS = 300;

export class Line {
  // path: of the frames; take: called with each
  constructor(path, take) {
    this.path = path;
    this.take = take;
    this.frameAt = performance.now();
    this.connect();
    this.watch = setInterval(() => performance.now() - this.heardAt > SILENT_S * 1000 && this.connect(), 500);
  }

  // How long nothing has come, s.
  gap() {
    return (performance.now() - this.frameAt) / 1000;
  }

  // A person did something.  True where it went out.
  acted() {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send("acted");
    return true;
  }

  end() {
    clearInterval(this.watch);
    const socket = this.socket;
    this.socket = null; // its end is not a loss
    socket.close();
  }

  connect() {
    this.socket?.close();
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}${this.path}`, ["board51", page.token]);
    let opened = false;
    this.socket = socket;
    this.heardAt = performance.now();
    socket.onopen = () => (opened = true);
    socket.onmessage = (message) => {
      if (socket !== this.socket) return;
      const frame = JSON.parse(message.data);
      this.heardAt = this.frameAt = performance.now();
      server.says(frame.at_s);
      this.take(frame);
    };
    socket.onclose = async (event) => {
      if (socket !== this.socket) return;
      if (event.code === 4401) return renew("");
      // Refused before it opened: the server is away, or it is another one that does not know this session.
      if (!opened && (await server.knowsNobody())) return renew("");
      setTimeout(() => socket === this.socket && this.connect(), AGAIN_MS);
    };
  }
}
