// STOP: by button and by the key Esc, on every page.
//
// Rule 1: each press is a request of its own, at once, beside those that are not answered yet; more than UNANSWERED give
//         the oldest up, never the newest.
// Rule 2: what a coil is said to do is what samples say, never what an answer lets hope.
// Rule 3: STOP needs nothing but this script and the server: no confirmation, no focus.
// Rule 4: where a panel is open, Esc closes it first and says so: who closes a list by habit must not drop the ball.

import { page, server, toast } from "./server.js";

const UNANSWERED = 3, LATE_S = 3, SHOWN_S = 6, AGAIN_SHOWN_S = 20;

export const IN_DOUBT = "COIL MAY BE ON"; // of a fault that the board cannot end

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
    toast("Esc closed what was open; nothing was stopped. Esc again is STOP.", "note");
  }

  async press(board) {
    const flight = new AbortController();
    this.waiting.push(flight);
    while (this.waiting.length > UNANSWERED) this.waiting.shift().abort(new Error("given up for a newer one"));
    const asked = server.post(`/api/${board}/stop`, {}, { signal: flight.signal }); // before anything that may fail
    const press = { board, sessions: {}, at: performance.now(), replies: null, error: "", off: {}, on: null, goodAt: null };
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
    // What is good goes by itself, the rest stays until it is good or until the next press.
    press.goodAt = state === "good" ? press.goodAt ?? now : null;
    const over = (press.goodAt && now - press.goodAt > SHOWN_S * 1000) || (press.on && now - press.on > AGAIN_SHOWN_S * 1000);
    if (over) this.newest = null;
    this.say(over ? "" : text, over ? "none" : state);
  }

  words(press) {
    const rigs = this.rigs(), names = Object.keys(press.replies ?? (press.board === "*" ? rigs : { [press.board]: 0 }));
    const coils = names.map((name) => this.coil(press, name, rigs[name], press.replies?.[name]));
    const said = coils.map(([words], n) => (names.length > 1 ? `${names[n]}: ${words}` : words)).join(" \u00b7 ");
    const by_hand = "Switch the rig off by hand.";
    const refused = names.filter((name) => press.replies && !press.replies[name].accepted);
    if (press.error) return [`STOP NOT DELIVERED, or not answered (${press.error}). ${by_hand} ${said}`, "bad"];
    if (!press.replies) {
      const late = (performance.now() - press.at) / 1000;
      if (late < LATE_S) return [`STOP sent \u2026 ${said}`, "busy"];
      return [`STOP sent, NO ANSWER for ${late.toFixed(0)} s. ${by_hand} ${said}`, "bad"];
    }
    if (!names.length) return ["STOP: no rig is known yet, nothing was stopped", "bad"];
    const worst = ["bad", "busy", "warn"].find((state) => coils.some(([, its]) => its === state)) ?? "good";
    if (refused.length === names.length && names.length === 1) return [`STOP REFUSED. ${said}`, worst];
    if (refused.length) return [`STOP REFUSED for ${refused.join(", ")}${refused.length < names.length ? ", accepted for the others" : ""}: ${said}`, worst];
    return [`STOP accepted after ${press.took} ms: ${said}`, worst];
  }

  // [words, state] of one coil, by its samples.
  coil(press, name, rig, reply) {
    if (reply && !reply.accepted) {
      const why = `REFUSED by ${reply.refused_by} (${reply.reason}): ${reply.text}`;
      if (rig?.fresh && rig.idle) return [`${why} Its coil is off, says the sample of tick ${rig.tick}.`, "bad"];
      return [`${why} Switch ${name} off by hand.`, "bad"];
    }
    if (!rig?.fresh) {
      const before = press.off[name] ? `coil off at tick ${press.off[name]}, ` : "";
      return [`${before}no samples come now, so whether the coil is off is not known`, "warn"];
    }
    if (rig.coil === IN_DOUBT) return ["THE COIL MAY BE ON: cut its supply", "bad"];
    // A sample older than the STOP says nothing of it.
    const after = reply && (rig.tick >= reply.tick || rig.session !== press.sessions[name]);
    if (rig.idle) {
      press.off[name] = rig.tick;
      press.on = null;
      return [reply && !after ? `accepted at tick ${reply.tick}, waiting for its sample` : `coil off, says the sample of tick ${rig.tick}`,
              reply && !after ? "busy" : "good"];
    }
    if (press.off[name]) {
      press.on ??= performance.now();
      return [`it was off and is ON AGAIN: ${rig.mode} \u00b7 coil on`, "bad"];
    }
    if (reply && !after) return [`accepted at tick ${reply.tick}, waiting for its sample`, "busy"];
    return [`COIL ON, say the samples: ${rig.mode}`, reply ? "bad" : "busy"];
  }
}
