// The live part of a page: frames in by WebSocket, values, plots and lists out, STOP by button and by key.
//
// Rule 1: what is shown is fresh or says that it is not: the page judges the age of the frames by its own clock.
// Rule 2: STOP needs nothing but this script and the server: no framework, no confirmation, no focus.
// Rule 3: a lost connection is tried again for ever; where the session is over, the server sends the page to the login.

import { Ball } from "./ball.js";
import { Plot, SPAN_S } from "./plot.js";

const page = document.querySelector("meta[name=board51]").dataset;
const FRAME_LIMIT_S = 0.7; // without a frame for so long, the server or the line to it is gone
const ACTED_EVERY_S = 20;
const IDLE_DRAW_MS = 100; // between drawings while no frames come: the age of what is shown counts up

// NiceGUI mounts the page after this script runs, and may replace what it mounted: elements are looked up when needed.
const $ = (name) => document.querySelector(`[data-live="${name}"]`);
const $$ = (name) => document.querySelectorAll(`[data-live="${name}"]`);

function put(name, text, state) {
  for (const element of $$(name)) {
    if (element.textContent !== text) element.textContent = text;
    if (state !== undefined && element.dataset.state !== state) element.dataset.state = state;
  }
}

// Noise around zero must not flicker between 0.000 and -0.000.
const shown = (value, scale, digits) =>
  value === null || value === undefined ? "\u2013" : (value * scale).toFixed(digits).replace(/^-(0\.?0*)$/, "$1");

export async function post(path, body) {
  const response = await fetch(path, {
    method: "POST",
    keepalive: true,
    headers: { "content-type": "application/json", "x-board51-token": page.token },
    body: JSON.stringify(body ?? {}),
  });
  if (response.status === 401) location.reload();
  return response.json();
}

// --- STOP ---------------------------------------------------------------------------------------------------------

let stopping = false;

async function stop() {
  if (stopping || !page.stop) return;
  stopping = true;
  say("stop-said", "STOP sent \u2026", "busy");
  const begun = performance.now();
  try {
    const reply = await Promise.race([
      post(`/api/${page.board}/stop`),
      new Promise((_, fail) => setTimeout(() => fail(new Error("no answer for 3 s")), 3000)),
    ]);
    const took = `${Math.round(performance.now() - begun)} ms`;
    if (reply.accepted) say("stop-said", `STOP accepted after ${took}: coil off`, "good");
    else say("stop-said", `STOP REFUSED: ${reply.text} Switch the rig off by hand.`, "bad");
  } catch (error) {
    say("stop-said", `STOP NOT DELIVERED (${error.message}). Switch the rig off by hand.`, "bad");
  } finally {
    stopping = false;
  }
}

let saidTimer = 0;

function say(name, text, state) {
  put(name, text, state);
  clearTimeout(saidTimer);
  if (state !== "bad") saidTimer = setTimeout(() => put(name, "", "none"), 6000);
}

// Capture phase on window: an open dialog or a focused field must not swallow it.
window.addEventListener(
  "keydown",
  (event) => {
    if (event.key === "Escape" && !event.repeat) stop();
  },
  { capture: true },
);
window.addEventListener(
  "click",
  (event) => {
    const target = event.target.closest?.("[data-act]");
    if (!target) return;
    if (target.dataset.act === "stop") stop();
    if (target.dataset.act === "acknowledge")
      post(`/api/${page.board}/acknowledge`, { name: target.dataset.name }).then((reply) => {
        if (reply.text) say("stop-said", reply.text, "bad");  // refused, or seen in this view alone
      });
  },
  { capture: true },
);

// --- frames in ----------------------------------------------------------------------------------------------------

let socket = null, lastFrame = performance.now(), now = null, rest = null, boards = null, actedAt = 0, everLive = false;
const rows = { s: [], t: [], d: [] };

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  socket = new WebSocket(`${scheme}://${location.host}${page.live}`, ["board51", page.token]);
  let opened = false;
  socket.onopen = () => (opened = true);
  socket.onmessage = (message) => take(JSON.parse(message.data));
  socket.onclose = async (event) => {
    if (event.code === 4401) return location.reload();
    // Refused before it opened: the server is away, or it is another one that does not know this session.
    if (!opened && (await knowsNobody())) return location.reload();
    setTimeout(connect, 300);
  };
}

async function knowsNobody() {
  try {
    return (await fetch("/api/session", { headers: { accept: "application/json", "x-board51-token": page.token } })).status === 401;
  } catch {
    return false;
  }
}

function take(frame) {
  lastFrame = performance.now();
  drawSoon();
  if (frame.boards) boards = frame.boards;
  if (frame.now) now = frame.now;
  if (frame.rest) {
    rest = frame.rest;
    lists();
  }
  if (frame.left_s !== undefined) sessionLeft(frame.left_s);
  for (const row of frame.rows ?? []) {
    const list = rows[row[0]], last = list[list.length - 1];
    if (last && (row[1] !== last[1] || row[2] < last[2])) list.length = 0; // a new session: another clock
    list.push(row);
  }
  for (const list of Object.values(rows)) {
    const newest = list.length ? list[list.length - 1][2] : 0;
    let old = 0;
    while (old < list.length && list[old][2] < newest - SPAN_S - 1) old++;
    if (old > 50) list.splice(0, old);
  }
}

function sessionLeft(left) {
  put("session", left < 120 ? `session ends in ${Math.max(0, Math.round(left))} s: press any key to stay` : "", left < 120 ? "warn" : "none");
}

for (const kind of ["pointerdown", "keydown"]) {
  window.addEventListener(kind, () => {
    if (performance.now() - actedAt < ACTED_EVERY_S * 1000 || socket?.readyState !== WebSocket.OPEN) return;
    actedAt = performance.now();
    socket.send("acted");
  });
}

// --- values and words out -----------------------------------------------------------------------------------------

const LINK_WORDS = { live: page.replay ? "\u25b6 REPLAYING" : "\u25cf LIVE", silent: "\u25b2 SILENT", absent: "\u2715 ABSENT", connecting: "\u25b2 CONNECTING",
                     handshake: "\u25b2 HANDSHAKE", "no-gateway": "\u2715 NO GATEWAY" };

// "" where what is shown is true now; else why not, in words.
function lost() {
  const gap = (performance.now() - lastFrame) / 1000;
  if (gap > FRAME_LIMIT_S) return `NO DATA for ${gap.toFixed(0)} s \u2013 this page has lost its server`;
  if (!now) return "waiting for data";
  if (now.link === "live") return "";
  const age = now.age_s === null ? "" : ` for ${Math.max(1, now.age_s).toFixed(0)} s`;
  return `NO DATA${age} \u2013 ${now.reason || now.link}`;
}

function values() {
  const missing = lost(), gone = missing !== "";
  const live = gone ? "no" : "yes";
  if (document.body.dataset.live !== live) document.body.dataset.live = live;
  if (!gone) everLive = true;
  put("lost", gone && (everLive || now) ? missing : gone ? "waiting for data \u2026" : "", gone ? "bad" : "none");
  if (!now) return;
  const serverGone = performance.now() - lastFrame > FRAME_LIMIT_S * 1000;
  put("link", serverGone ? "\u2715 NO SERVER" : LINK_WORDS[now.link] ?? `\u25b2 ${now.link.toUpperCase()}`, gone ? "bad" : "good");
  put("x", shown(now.x_m, 1e3, 3));
  put("x_ref", shown(now.x_ref_m, 1e3, 3));
  put("i_c", shown(now.i_c_a, 1, 3));
  put("u_c", shown(now.u_c_v, 1, 3));
  put("twin_x", shown(now.twin_x_m, 1e3, 3));
  const coil = now.mode === "idle" ? "coil off" : "coil on";
  put("mode", now.mode ? `${now.mode} \u00b7 ${coil}` : "\u2013", now.mode === "idle" ? "idle" : "on");
  const flags = now.flags ?? [];
  put("flags", flags.length ? `\u25b2 ${flags.join(", ")}` : "no flags", flags.includes("FAULT") ? "bad" : flags.length ? "warn" : "none");
  const above = now.nis_mean !== null && now.nis_on && now.nis_mean > now.nis_on;
  if (plots.length) plots[2].line = now.nis_on ?? null;
  if (now.twin === "in-step" && above) put("twin", "\u25b2 twin diverges", "warn");
  else put("twin", { none: "\u25cb no twin", stale: "\u25b2 twin silent", "in-step": "\u25cf twin in step", settling: "\u25d4 twin settling",
                "out-of-step": "\u2715 twin out of step" }[now.twin] ?? now.twin, now.twin === "in-step" ? "good" : now.twin === "out-of-step" ? "bad" : "warn");
  put("error_x", shown(now.error_x_m, 1e6, 0));
  put("error_i", shown(now.error_i_a, 1e3, 0));
  put("nis", shown(now.nis_mean, 1, 2));
  for (const button of document.querySelectorAll("[data-mode]")) {
    const pressed = String(button.dataset.mode === now.mode);
    if (button.getAttribute("aria-pressed") !== pressed) button.setAttribute("aria-pressed", pressed);
  }
}

function cell(tag, text, className) {
  const element = document.createElement(tag);
  element.textContent = text;
  if (className) element.className = className;
  return element;
}

const filled = {};

// Only what changed is made anew: a button that is replaced between press and release is never clicked.
function fill(name, data, row, empty) {
  const text = JSON.stringify(data);
  if (filled[name] === text && $(name)?.childElementCount) return;
  filled[name] = text;
  for (const place of $$(name)) place.replaceChildren(...(data.length ? data.map(row) : [cell("div", empty, "empty")]));
}

function lists() {
  const status = rest.status;
  if (status) {
    const writing = status.log_state === "writing";
    put("log", writing ? "\u25cf log writing" : status.log_state === "off" ? "\u25cb log off" : `\u2715 log ${status.log_state}`,
        writing ? "good" : status.log_state === "off" ? "warn" : "bad");
    const unanswered = status.to_board === "unanswered";
    put("to-board", unanswered ? "\u2715 BOARD DOES NOT ANSWER \u2013 STOP may not reach it" : "", unanswered ? "bad" : "none");
    put("rate", `${status.samples_per_s} samples/s, ${status.lost} lost`);
    fill("health", [
      ["port", status.port], ["commands to the board", status.to_board || "\u2013"], ["samples", `${status.samples_per_s} /s`], ["lost samples", status.lost], ["bad frames", status.bad_frames],
      ["latency p99", `${status.latency_p99_ms} ms`], ["line load", `${status.line_load} %`], ["not published", status.dropped],
      ["board resets", status.resets], ["reconnections", status.reconnects],
      ["log file", status.log_file || "\u2013"], ["log", `${status.log_state}, ${status.log_mb} MB`], ["not logged", status.log_dropped],
      ["law", rest.limits ? `${rest.limits.law} ${rest.limits.gains.join(", ")}` : "\u2013"],
      ["twin's model", rest.model ? `${rest.model.name} ${rest.model.sha256}` : "\u2013"],
    ], ([key, value]) => {
      const row = cell("div", "", "pair");
      row.append(cell("span", key, "key"), cell("span", String(value), "value"));
      return row;
    }, "no status yet");
  }
  fill("alarms", rest.alarms, (alarm) => {
    const row = cell("div", "", "alarm");
    row.dataset.state = alarm.active ? (alarm.severity === "fault" ? "fault" : "warning") : "gone";
    const standing = alarm.active ? (alarm.severity === "fault" ? "\u2716 FAULT" : "\u25b2 WARNING") : "\u25bd gone";
    row.append(cell("span", standing, "standing"), cell("span", alarm.name, "name"),
               cell("span", `${alarm.since}${alarm.times > 1 ? `, ${alarm.times} times` : ""}`, "at"));
    if (alarm.acknowledged) row.append(cell("span", `\u2713 seen by ${alarm.by}`, "seen"));
    else if (page.stop) {
      const button = cell("button", "Acknowledge", "ack");
      button.dataset.act = "acknowledge";
      button.dataset.name = alarm.name;
      row.append(button);
    }
    row.append(cell("div", alarm.text, "text"));
    return row;
  }, "\u2713 no alarms");
  const waiting = rest.alarms.filter((a) => a.active || !a.acknowledged);
  const faults = waiting.filter((a) => a.active && a.severity === "fault").length;
  put("alarm-count", waiting.length ? `${faults ? "\u2716" : "\u25b2"} ${waiting.length} alarm${waiting.length > 1 ? "s" : ""}` : "\u2713 no alarms",
      faults ? "bad" : waiting.length ? "warn" : "good");
  fill("events", rest.events, (event) => {
    const row = cell("div", "", "entry");
    row.dataset.state = event.severity;
    const mark = { fault: "\u2716", warning: "\u25b2" }[event.severity] ?? "\u00b7";
    row.append(cell("span", event.at, "at"), cell("span", `${mark} ${event.name}`, "name"), cell("span", event.text, "text"));
    return row;
  }, "no events since this page's server started");
  fill("commands", rest.commands, (command) => {
    const row = cell("div", "", "entry");
    row.dataset.state = command.accepted ? "info" : "warning";
    row.append(cell("span", command.at, "at"), cell("span", `${command.who || "?"}: ${command.what}`, "name"),
               cell("span", `${command.accepted ? "\u2713" : "\u2715"} ${command.result} ${command.text}`, "text"));
    return row;
  }, "no commands since this page's server started");
  ball?.setTravel(rest.travel_m);
}

const cards = new Map();

function card(name) {
  const link = cell("a", "", "board-card");
  link.href = `${page.prefix}/${name}`;
  const head = cell("div", "", "board-head");
  const parts = { link: cell("span", "", "board-link"), x: cell("div", "", "board-x"), text: cell("div", "", "board-text"), alarms: cell("div", "", "board-alarms") };
  head.append(cell("span", name, "board-name"), parts.link);
  link.append(head, parts.x, parts.text, parts.alarms);
  return { link, parts };
}

const NOBODY = page.replay
  ? "Nothing is replayed yet: it starts within seconds of Replay under Logs."
  : "No board has been heard yet. Is the gateway running?";

function overview() {
  const place = $("boards");
  if (!place) return;
  const gap = (performance.now() - lastFrame) / 1000, gone = gap > FRAME_LIMIT_S;
  put("lost", gone ? `NO DATA for ${gap.toFixed(0)} s \u2013 this page has lost its server` : "", gone ? "bad" : "none");
  if (!boards?.length) {
    if (!place.childElementCount) place.append(cell("div", NOBODY, "empty"));
    return;
  }
  if (!cards.size) place.replaceChildren();
  for (const board of boards) {
    if (!cards.has(board.name)) cards.set(board.name, card(board.name));
    const { link, parts } = cards.get(board.name), live = board.link === "live" && !gone;
    if (link.parentElement !== place) place.append(link);
    link.dataset.state = !live || board.fault ? "bad" : board.alarms ? "warn" : "good";
    parts.link.textContent = gone ? "\u2715 NO SERVER" : LINK_WORDS[board.link] ?? board.link;
    parts.x.textContent = live ? `${shown(board.x_m, 1e3, 3)} mm` : `no data${board.age_s === null ? "" : ` for ${Math.round(board.age_s)} s`}`;
    parts.text.textContent = live ? `reference ${shown(board.x_ref_m, 1e3, 3)} mm \u00b7 ${board.mode}` : board.reason;
    parts.alarms.textContent = board.alarms ? `${board.fault ? "\u2716" : "\u25b2"} ${board.alarms} alarm${board.alarms > 1 ? "s" : ""}` : "\u2713 no alarms";
  }
}

// --- drawing ------------------------------------------------------------------------------------------------------

let plots = [], ball = null;
const MEASURED = "#0b57a4", TWIN = "#c25e00", REFERENCE = "#3c7a3c", INPUT = "#6b4ba1";

function setUp() {
  if (plots.length || !$("plot-x")) return;
  plots = [
    new Plot($("plot-x"), { title: "Position", unit: "mm", scale: 1e3, minSpan: 0.4, floor: -0.15, series: [
      { kind: "s", low: 3, high: 4, name: "measured", style: MEASURED },
      { kind: "t", low: 3, high: 4, name: "twin", style: TWIN, dash: [7, 4], width: 1.8 },
      { kind: "s", low: 5, high: 5, name: "reference", style: REFERENCE, dash: [2, 3], width: 2 } ] }),
    new Plot($("plot-i"), { title: "Current and input", unit: "", minSpan: 0.1, series: [
      { kind: "s", low: 6, high: 7, name: "i_c (A)", style: MEASURED },
      { kind: "t", low: 5, high: 6, name: "twin (A)", style: TWIN, dash: [7, 4], width: 1.8 },
      { kind: "s", low: 8, high: 9, name: "u_c (V)", style: INPUT, width: 1.1, dash: [1, 2] } ] }),
    new Plot($("plot-d"), { title: "Divergence", unit: "mean NIS", log: true, floor: 0.5, series: [
      { kind: "d", low: 5, high: 5, name: "rig against model; 2 is noise alone", style: MEASURED, width: 2 } ] }),
  ];
  ball = new Ball($("ball"));
  if (rest) ball.setTravel(rest.travel_m);
}

// The board's time of now: that of the newest row, carried on smoothly by this clock while rows come.
let head = null;

function boardNow() {
  const newest = rows.s.length ? rows.s[rows.s.length - 1][2] : null;
  if (newest === null) return 0;
  const at = performance.now() / 1000;
  if (head === null || Math.abs(head.t + at - head.at - newest) > 0.3) head = { t: newest, at };
  const guess = head.t + at - head.at;
  head = { t: guess + (newest - guess) * 0.05, at };
  return Math.min(head.t, newest + 0.05);
}

// Drawn when a frame has come, 30 times a second, and not 60: between two of them there is nothing new to show.
let drawing = false;

function drawSoon() {
  if (!drawing) requestAnimationFrame(draw);
  drawing = true;
}

function draw() {
  drawing = false;
  setUp();
  overview();
  if (page.board) values();
  if (!plots.length) return;
  const missing = lost(), at = missing && rows.s.length ? rows.s[rows.s.length - 1][2] : boardNow();
  for (const plot of plots) plot.draw(rows, at, missing && everLive ? missing : "");
  if (missing) ball.show(null, null, null);
  else ball.show(now.x_m, now.twin_x_m, now.x_ref_m);
}

connect();
setInterval(drawSoon, IDLE_DRAW_MS);
// A hidden tab gets no animation frames, but what it says must still be true when somebody looks.
setInterval(() => page.board && values(), 250);
