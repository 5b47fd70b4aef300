// The cards of all rigs: from COMPACT rigs on a row each, so that they fit one screen.
//
// Rule: the line of x is made of the frames that come anyway, and of what the first one bears of the time before; it is
// drawn only with a new frame and only while its card is on the screen.

import { alarmWords } from "./alarms.js";
import { $, cell } from "./dom.js";
import { may, page } from "./server.js";
import { textOf } from "./texts.js";

const COMPACT = 8, SPARK_S = 30, GAP_S = 1, WIDTH = 300, HEIGHT = 40, LEAST_MM = 0.2;
const SVG = "http://www.w3.org/2000/svg";
const cards = new Map();
const seen = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) for (const one of cards.values()) if (one.box === target) one.onScreen = isIntersecting;
});

function card(name) {
  const box = cell("div", "", "board-card"), link = cell("a", "", "board-link-all");
  link.href = `${page.prefix}/${name}`;
  const parts = {};
  for (const part of ["name", "link", "x", "spark", "range", "text", "model", "alarms"]) {
    parts[part] = cell("div", part === "name" ? name : "", `board-${part}`);
    link.append(parts[part]);
  }
  const svg = document.createElementNS(SVG, "svg");
  parts.line = document.createElementNS(SVG, "path");
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute("preserveAspectRatio", "none");
  svg.append(parts.line);
  parts.spark.append(svg);
  box.append(link);
  if (!page.replay) {
    const stop = cell("button", textOf("stop.button_of", { rig: name }), "stop-one");
    Object.assign(stop.dataset, { act: "stop", board: name });
    stop.type = "button";
    box.append(stop);
  }
  if (may.has("acknowledge")) {
    parts.remove = cell("button", textOf("overview.remove", { rig: name }), "plain");
    Object.assign(parts.remove.dataset, { act: "remove", board: name });
    Object.assign(parts.remove, { type: "button", hidden: true });
    box.append(parts.remove);
  }
  seen.observe(box);
  return { box, parts, points: [], session: null, drawn: null, onScreen: true };
}

// A frame has come: [t_s, x_mm] of each rig are kept for SPARK_S.
export function remember(boards, sparks) {
  for (const board of boards ?? []) {
    const one = cards.get(board.name) ?? cards.set(board.name, card(board.name)).get(board.name), last = one.points.at(-1);
    if (one.session !== board.session || board.t_s < last?.[0]) one.points.length = 0; // another clock
    one.session = board.session;
    const before = one.points.length ? [] : (sparks?.[board.name] ?? []).map(([t, x]) => [t, x === null ? null : x * 1e3]);
    const x_mm = board.x_m === null || board.x_m === undefined ? null : board.x_m * 1e3;
    for (const point of [...before, [board.t_s, x_mm]]) {
      if (point[0] !== undefined && !(point[0] <= one.points.at(-1)?.[0])) one.points.push(point);
    }
    while (one.points.length && one.points[0][0] < board.t_s - SPARK_S) one.points.shift();
  }
}

function draw({ line, range }, points) {
  const end = points.at(-1)[0], values = points.map((point) => point[1]).filter((x) => x !== null);
  const low = Math.min(...values), high = Math.max(...values), span = Math.max(high - low, LEAST_MM), middle = (low + high) / 2;
  let words = "", before = null;
  for (const [t, x] of points) {
    if (x === null) {
      before = null;
      continue;
    }
    const at = WIDTH * (1 - (end - t) / SPARK_S), y = HEIGHT * (0.5 - (0.9 * (x - middle)) / span);
    words += `${before !== null && t - before < GAP_S ? "L" : "M"}${at.toFixed(1)} ${y.toFixed(1)}`;
    before = t;
  }
  line.setAttribute("d", words);
  range.textContent = values.length ? textOf("overview.range", { seconds: SPARK_S, low: low.toFixed(2), high: high.toFixed(2) }) : "";
}

// state(board): {live, link, x, text} in words.
export function showBoards(boards, isGone, nobody, words) {
  const place = $("boards");
  if (!place) return;
  for (const name of [...cards.keys()].filter((one) => !boards?.some((board) => board.name === one))) {
    cards.get(name).box.remove();
    cards.delete(name);
  }
  if (!boards?.length) {
    if (place.textContent !== nobody) place.replaceChildren(cell("div", nobody, "empty"));
    return;
  }
  place.querySelector(".empty")?.remove();
  place.dataset.size = boards.length >= COMPACT ? "compact" : boards.length === 1 ? "one" : "some";
  boards.forEach((board, n) => {
    const one = cards.get(board.name), { box, parts } = one, said = words(board);
    if (place.children[n] !== box) place.insertBefore(box, place.children[n] ?? null);
    if (parts.remove) parts.remove.hidden = !board.unseen || isGone;
    box.dataset.state = !said.live || board.fault ? "bad" : board.alarms + board.gone ? "warn" : "good";
    const alarms = alarmWords(board.alarms, board.gone, board.fault, board.shelved), { model } = board;
    const texts = { link: said.link, x: said.x, text: said.text, alarms, model: model ? textOf("overview.model", { model }) : "" };
    for (const [part, text] of Object.entries(texts)) if (parts[part].textContent !== text) parts[part].textContent = text;
    const newest = one.points.at(-1);
    if (!newest || newest === one.drawn || !one.onScreen || document.hidden) return;
    one.drawn = newest;
    draw(parts, one.points);
  });
}
