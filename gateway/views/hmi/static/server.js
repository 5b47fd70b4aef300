// What a page asks of its server: one plain request each, answered or not, and nothing else to keep in step.
//
// Rule 1: a request says when it was made, by the server's clock: one that the network held up is refused there, so
//         a request that was reported as not answered does not act later.  STOP has no such date.
// Rule 2: the browser has six connections for a server: STOP's three and the question for the session are kept free.

import { textOf } from "./texts.js";

export const page = document.querySelector("meta[name=board51]").dataset;
export const may = new Set(page.may.split(" "));

const ANSWER_S = 10, MAX_ACTS = 2, SAID = "board51-said";

class NotSent extends Error {}

class Server {
  constructor() {
    this.ahead = -Infinity; // of performance.now(), s
    this.says(Number(page.now));
    this.acts = 0;
  }

  // A date by the server's clock has come; what travelled longest dates from too early, and counts least.
  says(at_s) {
    this.ahead = Math.max(this.ahead, at_s - performance.now() / 1000);
  }

  // The answer to an act.  Raises an Error where there is none.
  async ask(path, body, { limit = ANSWER_S, method = "POST" } = {}) {
    if (this.acts >= MAX_ACTS) throw new NotSent();
    this.acts += 1;
    try {
      const seen = (this.ahead + performance.now() / 1000).toFixed(3);
      return await this.post(path, body, { signal: AbortSignal.timeout(limit * 1000), headers: { "x-board51-seen": seen }, method });
    } catch (error) {
      if (error.name === "TimeoutError") throw new Error(textOf("request.no_answer", { seconds: limit }));
      throw error;
    } finally {
      this.acts -= 1;
    }
  }

  async post(path, body, { signal, headers = {}, method = "POST" }) {
    const raw = body instanceof Blob;
    const response = await fetch(path, {
      method,
      signal,
      keepalive: !raw,
      headers: { ...headers, "content-type": raw ? "application/octet-stream" : "application/json", "x-board51-token": page.token },
      body: method === "GET" ? undefined : raw ? body : JSON.stringify(body ?? {}),
    });
    const answer = await response.json();
    if (response.status === 401 || answer.reason === "token") renew(textOf("request.session_over"));
    return answer;
  }

  async knowsNobody() {
    try {
      const headers = { accept: "application/json", "x-board51-token": page.token };
      return (await fetch("/api/session", { headers, signal: AbortSignal.timeout(3000) })).status === 401;
    } catch {
      return false;
    }
  }
}

// Reload the page, or show the login instead; `said` is shown afterwards.
export function renew(said) {
  if (said) sessionStorage.setItem(SAID, said);
  location.reload();
}

export const server = new Server();

// --- what became of an act ------------------------------------------------------------------------------------------

const SUPERSEDED = "superseded-by-stop"; // an act that was issued before a STOP
const SHOWN_MS = 4000, BAD_SHOWN_MS = 15000, MAX_TOASTS = 3;

// Words at the edge of the page, to be changed until the act is over.  They go after a while, those about STOP only by
// hand; a repeated message replaces the earlier one.
export function toast(text, state = "busy", about = "") {
  const place = document.querySelector(".toasts"), element = document.createElement("div"), words = document.createElement("span");
  element.className = "toast";
  element.append(words);
  place.append(element);
  const say = (text, state, about = "") => {
    words.textContent = text;
    Object.assign(element.dataset, { state, about });
    const others = [...place.children].filter((one) => one !== element);
    for (const other of others) if (other.firstChild.textContent === text) other.remove();
    while (place.childElementCount > MAX_TOASTS) {
      (others.find((one) => one.isConnected && one.dataset.about !== "stop") ?? place.firstElementChild).remove();
    }
    if (state === "busy") return;
    if (about !== "stop") setTimeout(() => element.remove(), state === "bad" ? BAD_SHOWN_MS : SHOWN_MS);
    if ((state !== "bad" && about !== "stop") || element.childElementCount > 1) return;
    const close = document.createElement("button");
    close.type = "button";
    close.textContent = textOf("request.close");
    close.onclick = () => element.remove();
    element.append(close);
  };
  say(text, state, about);
  return say;
}

// Ask, and say what became of it under `name`.  Returns the answer, null where there was none.
export async function act(name, path, body, options) {
  const say = toast(textOf("request.busy", { act: name }));
  try {
    const answer = await server.ask(path, body, options);
    const { text, refused_by: by, reason } = answer;
    if (answer.accepted) say(text ? textOf("request.accepted_text", { act: name, text }) : textOf("request.accepted", { act: name }), "good");
    else say(by ? textOf("request.refused_by", { act: name, by, reason, text }) : textOf("request.refused", { act: name, text }), "bad", reason === SUPERSEDED ? "stop" : "");
    return answer;
  } catch (error) {
    if (error instanceof NotSent) say(textOf("request.not_sent", { act: name }), "bad");
    else say(textOf("request.not_answered", { act: name, error: error.message }), "bad");
    return null;
  }
}

const said = sessionStorage.getItem(SAID);
if (said) toast(said, "bad");
sessionStorage.removeItem(SAID);
