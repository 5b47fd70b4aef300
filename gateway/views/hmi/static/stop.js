// STOP: by button and by the key Esc, on every page.
//
// Rule 1: each press is a request of its own, at once, beside those that are not answered yet; more than UNANSWERED give
//         the oldest up, never the newest.
// Rule 2: the state of a coil is that of its samples, never a conclusion from an answer.
// Rule 3: STOP needs nothing but this script and the server: no confirmation, no focus.
// Rule 4: where a panel is open, Esc closes it first and says so: who closes a list by habit must not drop the ball.

import { page, server, toast } from "./server.js";
import { textOf, textsOf } from "./texts.js";

const UNANSWERED = 3, LATE_S = 3, SHOWN_S = 6, AGAIN_SHOWN_S = 20;

export const IN_DOUBT = "in-doubt"; // the coil of a board with a fault that it cannot end

export class Stop {
  // rigs(): {name: {fresh, idle, mode, coil, tick, session}} as samples say now; say(text, state): the words across the page
  constructor(rigs, say) {
    this.rigs = rigs;
    this.say = say;
    this.waiting = [];
    this.newest = null;
    // Capture phase on window: an open panel or a focused field must not swallow it.
    window.addEventListener("keydown", (event) => event.key === "Escape" && !event.repeat && this.escape(event), { capture: true });
    window.addEventListener("click", (event) => {
      const button = event.target.closest?.("[data-act=stop]");
      if (button) this.press(button.dataset.board);
    }, { capture: true });
    // Keys go to a frame that has the focus, and it has no script of ours.
    window.addEventListener("blur", () => setTimeout(() => document.activeElement?.tagName === "IFRAME" && (document.activeElement.blur(), window.focus())));
  }

  escape(event) {
    const open = document.querySelector("dialog[open]");
    if (!open && !event.isComposing) return this.press(page.stops);
    if (open) {
      event.preventDefault();
      open.close();
    }
    toast(textOf("stop.esc_closed"), "note", "stop");
  }

  async press(board) {
    const flight = new AbortController();
    this.waiting.push(flight);
    while (this.waiting.length > UNANSWERED) this.waiting.shift().abort(new Error(textOf("stop.replaced")));
    const asked = server.post(`/api/${board}/stop`, {}, { signal: flight.signal }); // before anything that may fail
    const press = { board, sessions: {}, at: performance.now(), replies: null, error: "", off: {}, on: null, goodAt: null, took: NaN };
    this.newest = press;
    try {
      for (const [name, rig] of Object.entries(this.rigs())) press.sessions[name] = rig.session;
      this.show();
      const answer = await asked;
      if (answer.boards) press.replies = answer.boards;
      else press.replies = { [board]: answer };
    } catch (error) {
      press.error = error.message;
    } finally {
      this.waiting = this.waiting.filter((other) => other !== flight);
      press.took = Math.round(performance.now() - press.at);
      this.show();
    }
  }

  // Words for the newest press and what samples say now; called with every drawing.
  show() {
    const press = this.newest, now = performance.now();
    if (!press) return;
    const [text, state] = this.words(press);
    // What is good goes by itself; the rest stays until it is good, until the next press, or until an answered STOP is
    // long superseded by a coil that somebody switched on again. Without an answer the last comparison is false.
    press.goodAt = state === "good" ? press.goodAt ?? now : null;
    const over = (press.goodAt && now - press.goodAt > SHOWN_S * 1000) || (press.on && now - Math.max(press.on, press.at + press.took) > AGAIN_SHOWN_S * 1000);
    if (over) this.newest = null;
    this.say(over ? "" : text, over ? "none" : state);
  }

  words(press) {
    const rigs = this.rigs(), names = Object.keys(press.replies ?? (press.board === "*" ? rigs : { [press.board]: 0 }));
    const coils = names.map((name) => this.coil(press, name, rigs[name], press.replies?.[name]));
    const of = ([coil], n) => (names.length > 1 ? textOf("stop.coil_of", { rig: names[n], coil }) : coil);
    const all = { coils: coils.map(of).join(" \u00b7 ") };
    const refused = names.filter((name) => press.replies && !press.replies[name].accepted);
    if (press.error) return [textOf("stop.not_delivered", { error: press.error, ...all }), "bad"];
    if (!press.replies) {
      const late = (performance.now() - press.at) / 1000;
      if (late < LATE_S) return [textOf("stop.sent", all), "busy"];
      return [textOf("stop.late", { seconds: late.toFixed(0), ...all }), "bad"];
    }
    if (!names.length) return [textOf("stop.no_rig"), "bad"];
    const worst = ["bad", "busy", "warn"].find((state) => coils.some(([, its]) => its === state)) ?? "good";
    if (!refused.length) return [textOf("stop.accepted", { ms: press.took, ...all }), worst];
    if (names.length === 1) return [textOf("stop.refused", all), worst];
    const of_rigs = { rigs: refused.join(", "), ...all };
    return [refused.length < names.length ? textOf("stop.refused_for_some", of_rigs) : textOf("stop.refused_for", of_rigs), worst];
  }

  // [words, state] of one coil, by its samples.
  coil(press, name, rig, reply) {
    if (reply && !reply.accepted) {
      const refusal = textOf("stop.refused_by", { by: reply.refused_by, reason: reply.reason, text: reply.text });
      if (rig?.fresh && rig.idle) return [textOf("stop.refused_but_off", { refusal, tick: rig.tick }), "bad"];
      return [textOf("stop.refused_by_hand", { refusal, rig: name }), "bad"];
    }
    if (!rig?.fresh) {
      const tick = press.off[name];
      return [tick ? textOf("stop.silent_was_off", { tick }) : textOf("stop.silent"), "warn"];
    }
    if (rig.coil === IN_DOUBT) return [textOf("stop.may_be_on"), "bad"];
    // A sample older than the STOP says nothing of it.
    const mode = textsOf("mode")[rig.mode] ?? rig.mode, waits = () => [textOf("stop.waiting", { tick: reply.tick }), "busy"];
    const after = reply && (rig.tick >= reply.tick || rig.session !== press.sessions[name]);
    if (rig.idle) {
      press.off[name] = rig.tick;
      press.on = null;
      return reply && !after ? waits() : [textOf("stop.off", { tick: rig.tick }), "good"];
    }
    if (press.off[name]) {
      press.on ??= performance.now();
      return [textOf("stop.on_again", { mode }), "bad"];
    }
    if (reply && !after) return waits();
    return [textOf("stop.on", { mode }), reply ? "bad" : "busy"];
  }
}
