// The live part of a page: frames in (line.js), values, plots and lists out.  STOP is stop.js, controls are acts.js.
//
// Rule: what is shown is fresh or says that it is not: the page judges the age of the frames by its own clock, and what
// was last known is marked as such wherever it stands.

import { follow, limits, showJobs } from "./acts.js";
import { counted, showAlarms, showJournal } from "./alarms.js";
import { Ball } from "./ball.js";
import { $, cell, fill, put } from "./dom.js";
import { Line } from "./line.js";
import { History } from "./history.js";
import { remember, showBoards } from "./overview.js";
import { Plots } from "./plots.js";
import { isRunning, standAt, standing, still } from "./replay.js";
import { may, page } from "./server.js";
import { IN_DOUBT, Stop } from "./stop.js";
import { textOf, textsOf } from "./texts.js";

const FRAME_LIMIT_S = 0.7; // after this time without a frame, the server or the line to it is gone
const ACTED_EVERY_S = 20;
const IDLE_DRAW_MS = 100; // between drawings while no frames come: the age of what is shown counts up
const STATUS_LIMIT_S = 3.5; // it comes once a second

// Noise around zero must not flicker between 0.000 and -0.000.
const shown = (value, scale, digits) =>
  value === null || value === undefined ? "\u2013" : (value * scale).toFixed(digits).replace(/^-(0\.?0*)$/, "$1");

// --- frames in ----------------------------------------------------------------------------------------------------

let now = null, rest = null, boards = null, jobs = {}, actedAt = 0;
const history = new History();
const line = new Line(page.live, take);
// A page of a recording has frames of its own; STOP uses the frames of the live rigs.
let liveRigs = null;
const liveLine = page.replay ? new Line("/live", (frame) => (liveRigs = frame.boards)) : line;

function take(frame) {
  drawSoon();
  if (frame.boards) remember((boards = frame.boards), frame.sparks);
  if (frame.now) now = frame.now;
  if (frame.rest) {
    rest = frame.rest;
    lists();
    limits(rest);
    document.dispatchEvent(new CustomEvent("board51-rest", { detail: rest }));
  }
  if (frame.journal) showJournal(frame.journal);
  if (frame.jobs) showJobs((jobs = frame.jobs));
  if (frame.left_s !== undefined) sessionLeft(frame.left_s);
  for (const row of frame.past ?? []) history.fold(row);
  for (const row of frame.rows ?? []) history.take(row);
}

function sessionLeft(left) {
  const words = left < 120 ? textOf("line.session_ends", { seconds: Math.max(0, Math.round(left)) }) : "";
  put("session", words, words ? "warn" : "none");
}

for (const kind of ["pointerdown", "keydown"]) {
  window.addEventListener(kind, () => {
    if (performance.now() - actedAt > ACTED_EVERY_S * 1000 && line.acted()) actedAt = performance.now();
  });
}

// --- values and words out -----------------------------------------------------------------------------------------

const MODES = textsOf("mode"), COILS = textsOf("coil"), FLAGS = textsOf("flag"), TWIN = textsOf("twin"), LINK = textsOf("link");
// A replay that stands still shows the moment where it stands: no samples come, and nothing is lost.
const stands = () => page.replay && still();
const linkWords = (link) => (stands() ? standing() : link === "live" && page.replay ? LINK.replaying : LINK[link]) ?? link;
const modeWords = (mode) => MODES[mode] ?? mode;

// "" if the shown values are true now; otherwise the reason in words.
function lost() {
  const gap = line.gap();
  if (gap > FRAME_LIMIT_S) return textOf("line.no_server", { seconds: gap.toFixed(0) });
  if (!now) return textOf("line.waiting");
  if (now.link === "live" || stands()) return "";
  const reason = now.reason || linkWords(now.link);
  return now.age_s === null ? textOf("line.no_data", { reason }) : textOf("line.no_data_for", { seconds: Math.max(1, now.age_s).toFixed(0), reason });
}

// The activity at this rig.
function running() {
  const kinds = Object.entries(jobs).filter(([, job]) => job.running).map(([kind]) => kind);
  const words = kinds.map((kind) => textOf("rig.running", { job: textsOf("job_kind")[kind] ?? kind }));
  const excitation = now.mode === "idle" ? null : rest?.excitation, left = excitation && excitation.until_s - now.host_s;
  const shape = excitation && (textsOf("shape")[excitation.what] ?? excitation.what);
  if (excitation && !excitation.until_s) words.unshift(textOf("rig.excited", { shape }));
  else if (left > 0) words.unshift(textOf("rig.excited_for", { shape, seconds: Math.ceil(left) }));
  return words;
}

function values() {
  const missing = lost(), gone = missing !== "";
  const live = gone ? "no" : "yes";
  if (document.body.dataset.live !== live) document.body.dataset.live = live;
  put("lost", missing, gone && now ? "bad" : "none");
  if (!now) return;
  const serverGone = line.gap() > FRAME_LIMIT_S;
  put("link", serverGone ? LINK["no-server"] : linkWords(now.link), gone ? "bad" : "good");
  put("x", shown(now.x_m, 1e3, 3));
  put("x_ref", shown(now.x_ref_m, 1e3, 3));
  put("i_c", shown(now.i_c_a, 1, 3));
  put("u_c", shown(now.u_c_v, 1, 3));
  put("twin_x", shown(now.twin_x_m, 1e3, 3));
  put("runs", gone || page.replay ? "" : running().join(" \u00b7 "), "on");
  const calm = now.mode === "idle" ? "idle" : "on";
  chip("mode", now.mode ? textOf("rig.mode", { mode: modeWords(now.mode), coil: COILS[now.coil] }) : "\u2013", now.coil === IN_DOUBT ? "bad" : calm, gone);
  const flags = now.flags ?? [];
  const flagged = flags.length ? textOf("rig.flags", { flags: flags.map((flag) => FLAGS[flag]).join(", ") }) : textOf("rig.no_flags");
  put("flags", flagged, flags.includes("fault") ? "bad" : flags.length ? "warn" : "none");
  const above = now.nis_mean !== null && now.nis_on && now.nis_mean > now.nis_on;
  if (now.twin === "in-step" && above) chip("twin", TWIN.diverges, "warn", gone);
  else chip("twin", TWIN[now.twin] ?? now.twin, now.twin === "in-step" ? "good" : now.twin === "out-of-step" ? "bad" : "warn", gone);
  told(gone, serverGone);
  put("error_x", shown(now.error_x_m, 1e6, 0));
  put("error_i", shown(now.error_i_a, 1e3, 0));
  put("nis", shown(now.nis_mean, 1, 2));
  const flies = now.mode !== null && now.mode !== "idle" ? "flies" : "idle";
  for (const element of document.querySelectorAll("[data-while]")) element.hidden = element.dataset.while !== flies;
  for (const button of document.querySelectorAll("[data-mode]")) {
    const its = button.dataset.mode === now.mode, pressed = String(its && !gone), last = its && gone ? "yes" : "no";
    if (button.getAttribute("aria-pressed") !== pressed) button.setAttribute("aria-pressed", pressed);
    if (button.dataset.last !== last) button.dataset.last = last;
  }
  follow(now, gone);
}

// Words in the bar; words without present data are marked as the last known.
function chip(name, text, state, old) {
  put(name, old && text !== "\u2013" ? textOf("rig.last_known", { text }) : text, old ? "old" : state);
}

// What the gateway's status says, which goes on while the board is away.
function told(gone, serverGone) {
  const status = rest?.status;
  if (!status) return;
  const old = serverGone || status.age_s > STATUS_LIMIT_S, writing = status.log_state === "writing";
  if (writing && gone && !old) chip("log", textOf("log.no_samples"), "warn", false);
  else chip("log", writing ? textOf("log.writing") : status.log_state === "off" ? textOf("log.off") : textOf("log.failed", { state: status.log_state }),
            writing ? "good" : status.log_state === "off" ? "warn" : "bad", old);
  if (status.to_board === "unanswered") chip("to-board", textOf("rig.no_answer"), "bad", old);
  else put("to-board", "", "none");
  if (alarmsNow) chip("alarm-count", ...alarmsNow, serverGone);
}

const HEALTH = textsOf("health");
let alarmsNow = null; // words, state

function lists() {
  const status = rest.status;
  put("wrong", rest.wrong ? textOf("rig.model_error", { error: rest.wrong }) : "", rest.wrong ? "warn" : "none");
  put("named", rest.named ?? "", rest.named ? "warn" : "none");
  if (status) {
    fill("health", [
      ["port", status.port], ["to_board", status.to_board || "\u2013"], ["samples", `${status.samples_per_s} /s`],
      ["lost_samples", status.lost], ["bad_frames", status.bad_frames], ...Object.entries(status.unexpected),
      ["latency", status.latency_p99_ms ? `${status.latency_p99_ms} ms` : "\u2013"], ["line_load", `${status.line_load} %`], ["not_published", status.dropped],
      ["resets", status.resets], ["reconnections", status.reconnects],
      ["log_file", status.log_file || "\u2013"], ["log", `${status.log_state}, ${status.log_mb} MB`], ["not_logged", status.log_dropped],
      ["law", rest.limits ? `${rest.limits.law} ${rest.limits.gains.join(", ")}` : "\u2013"],
      ["model", rest.model ? `${rest.model.name} ${rest.model.sha256}` : "\u2013"],
    ], ([key, value]) => {
      const row = cell("div", "", "pair");
      row.append(cell("span", HEALTH[key] ?? key, "key"), cell("span", String(value), "value"));
      return row;
    }, textOf("rig.no_health"));
  }
  showAlarms(rest.alarms);
  alarmsNow = counted(rest.alarms);
  put("alarm-tab", String(rest.alarms.filter((alarm) => alarm.active && alarm.group !== "shelved").length || ""), alarmsNow[1]);
  fill("events", rest.events, (event) => {
    const row = cell("div", "", "entry");
    row.dataset.state = event.severity;
    const mark = { fault: "\u2716", warning: "\u25b2" }[event.severity] ?? "\u00b7";
    row.append(cell("span", event.at, "at"), cell("span", `${mark} ${event.name}`, "name"), cell("span", event.text, "text"));
    return row;
  }, textOf("rig.no_events"));
  fill("commands", rest.commands, (command) => {
    const row = cell("div", "", "entry");
    row.dataset.state = command.accepted ? "info" : "warning";
    row.append(cell("span", command.at, "at"), cell("span", textOf("command.by", { who: command.who || "?", command: command.what }), "name"),
               cell("span", `${command.accepted ? "\u2713" : "\u2715"} ${command.result} ${command.text}`, "text"));
    return row;
  }, textOf("rig.no_commands"));
  ball?.setTravel(rest.travel_m);
}

const NOBODY = page.replay ? textOf("overview.nothing_replayed") : textOf("overview.waiting");

function overview() {
  if (page.board) return;
  const gap = line.gap(), gone = gap > FRAME_LIMIT_S;
  put("lost", gone ? textOf("line.no_server", { seconds: gap.toFixed(0) }) : "", gone ? "bad" : "none");
  showBoards(boards, gone, isRunning() ? textOf("replay_state.starting") : NOBODY, (board) => {
    const live = (board.link === "live" || stands()) && !gone, link = gone ? LINK["no-server"] : linkWords(board.link);
    if (live) {
      const state = { x_ref: shown(board.x_ref_m, 1e3, 3), mode: modeWords(board.mode), coil: COILS[board.coil] };
      return { live, link, x: textOf("overview.position", { x: shown(board.x_m, 1e3, 3) }), text: textOf("overview.state", state) };
    }
    const x = board.age_s === null ? textOf("overview.no_data") : textOf("overview.no_data_for", { seconds: Math.round(board.age_s) });
    return { live, link, x, text: board.reason };
  });
}

// --- drawing ------------------------------------------------------------------------------------------------------

let plots = null, ball = null;

for (const button of document.querySelectorAll("[data-tab-of]")) {
  button.onclick = () => {
    document.querySelector("main").dataset.tab = button.dataset.tabOf;
    for (const other of document.querySelectorAll("[data-tab-of]")) other.setAttribute("aria-pressed", String(other === button));
    scrollTo(0, 0);
  };
}

function setUp() {
  if (plots || !$("plot-x")) return;
  plots = new Plots(history);
  ball = new Ball($("ball"));
  if (rest) ball.setTravel(rest.travel_m);
}

// What happened, as marks in the plots.
const marks = () => [...(rest?.events ?? []), ...(rest?.alarms ?? [])].filter((one) => one.at_s).sort((a, b) => a.at_s - b.at_s);

// The board's time of now: that of the newest row, carried on smoothly by this clock while rows come.
let head = null;

function boardNow() {
  const newest = history.newest;
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
  stopping.show();
  if (page.replay) standAt((now ?? boards?.[0])?.host_s);
  if (!plots) return;
  const missing = lost(), at = missing ? history.newest ?? 0 : boardNow();
  plots.draw(at, now, missing, marks());
  if (missing) ball.show(null, null, null);
  else ball.show(now.x_m, now.twin_x_m, now.x_ref_m);
}

// What samples say now of each rig that STOP here is for.
function rigs() {
  const gone = liveLine.gap() > FRAME_LIMIT_S;
  const rig = (b, fresh) => ({ fresh, idle: b.mode === "idle", mode: b.mode, coil: b.coil, tick: b.tick, session: b.session });
  if (page.stops !== "*") return now ? { [page.stops]: rig(now, lost() === "") } : {};
  const known = (page.replay ? liveRigs : boards) ?? [];
  return Object.fromEntries(known.map((b) => [b.name, rig(b, b.link === "live" && !gone)]));
}

const stopping = new Stop(rigs, (text, state) => put("stop-said", text, state));
setInterval(drawSoon, IDLE_DRAW_MS);
// A hidden tab gets no animation frames, but what it says must still be true when somebody looks.
setInterval(() => (page.board ? values() : overview()) ?? stopping.show(), 250);
// A report is as long as it is: the page scrolls, not the frame, which must not have the focus.
const report = document.querySelector("iframe");
const fit = () => (report.style.height = `${report.contentDocument.documentElement.scrollHeight + 20}px`);
report?.addEventListener("load", fit);
if (report?.contentDocument?.readyState === "complete") fit();
