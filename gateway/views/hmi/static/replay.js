// The timeline of a replay: where it stands, events and alarms as marks, pause, seek, speed.
//
// Rule: the page shows the last state that the replay reported; a press changes nothing before it is answered.

import { cell, put } from "./dom.js";
import { page, server, toast } from "./server.js";
import { textOf, textsOf } from "./texts.js";

const place = document.querySelector(".timeline"), slider = place?.querySelector("input"), strip = place?.querySelector(".marks");
const BEFORE_S = 0.5; // a click on a mark shows how it came about
const HOLD_MS = 2000, NEAR_S = 1; // after a seek the handle waits for frames from there
const STATES = textsOf("replay_state"), PAUSE = textOf("replay.pause"), PLAY = textOf("replay.play"), ACT = textOf("replay.act");
const clock = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;

let running = false, log = "", line = null, state = { state: "", speed: 1 }, held = 0;

// "" while samples come, or none may; else why what is shown stands still: "paused", "ended" or "over".
export const isRunning = () => running;
export const standing = () => STATES[state.state];
export const still = () => (["paused", "ended", "over"].includes(state.state) ? state.state : "");

function said(lines) {
  for (const text of [...lines].reverse()) {
    try {
      const one = JSON.parse(text);
      if (one?.state) return one;
    } catch {
      continue; // a line for people
    }
  }
  return { state: "", speed: 1 };
}

document.addEventListener("board51-jobs", ({ detail: { replay } }) => {
  if (!place || !replay) return;
  place.hidden = false;
  running = replay.running;
  if (replay.title !== log) read((log = replay.title));
  state = { ...said(replay.lines), ...(replay.running ? {} : { state: "over" }) };
  const { state: word } = state;
  put("replay-state", STATES[word || "starting"], word);
  for (const control of place.querySelectorAll("button, input")) control.disabled = word === "over" || (control === slider && !line);
  place.querySelector("[data-order]").textContent = word === "playing" ? PAUSE : PLAY;
  for (const button of place.querySelectorAll("[data-speed]")) button.setAttribute("aria-pressed", String(Number(button.dataset.speed) === state.speed));
});

async function read(name) {
  line = null;
  strip.replaceChildren();
  try {
    const answer = await (await fetch(`/api/timeline/${name}`, { headers: { "x-board51-token": page.token } })).json();
    if (name !== log) return;
    if (answer.marks) show(answer);
    else put("replay-marks", answer.text ?? textOf("replay.no_marks"));
  } catch {
    put("replay-marks", textOf("replay.no_marks"));
  }
}

function show(answer) {
  line = answer;
  slider.max = line.duration_s;
  const marks = line.marks.filter((mark) => !page.board || mark.board === page.board);
  put("replay-marks", textOf("replay.marks", { count: marks.length }));
  strip.setAttribute("aria-label", textOf("replay.marks", { count: marks.length }));
  strip.replaceChildren(...marks.map((mark) => {
    const element = cell("i", "", "mark");
    element.dataset.state = mark.severity;
    element.dataset.at = mark.at_s;
    element.style.left = `${(100 * mark.at_s) / line.duration_s}%`;
    element.title = textOf("replay.mark", { at: clock(mark.at_s), name: mark.name, text: mark.text });
    return element;
  }));
}

// host_s: Unix time of the newest sample.
export function standAt(host_s) {
  if (!line || host_s === undefined) return;
  const at = Math.min(Math.max(host_s - line.start_s, 0), line.duration_s);
  if (held && Math.abs(at - slider.value) > NEAR_S && performance.now() - held < HOLD_MS) return;
  held = 0;
  if (!slider.matches(":active")) slider.value = at;
  const words = textOf("replay.at", { at: clock(at), of: clock(line.duration_s) });
  put("replay-at", words);
  slider.setAttribute("aria-valuetext", words);
}

async function order(words) {
  const answer = await server.ask("/api/*/job", { kind: "replay", act: "order", order: words }).catch((error) => ({ text: error.message || error.name }));
  if (!answer.accepted) toast(textOf("request.refused", { act: ACT, text: answer.text }), "bad");
}

function seek(at_s) {
  held = performance.now();
  slider.value = Math.min(Math.max(at_s, 0), line.duration_s);
  order(`seek ${Number(slider.value).toFixed(2)}`);
}

place?.addEventListener("click", (event) => {
  const { order: wish, speed } = event.target.dataset;
  if (wish) order(state.state === "playing" ? "pause" : "play");
  else if (speed) order(`speed ${speed}`);
  else if (event.target.matches(".mark")) seek(event.target.dataset.at - BEFORE_S);
  else if (event.target === strip && line) seek((line.duration_s * event.offsetX) / strip.clientWidth);
});
slider?.addEventListener("input", () => (held = performance.now()));
slider?.addEventListener("change", () => seek(Number(slider.value)));
