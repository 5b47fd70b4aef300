// The ball between its stops, as SVG: measured (filled), twin (dashed outline), reference (arrow at the scale).
//
// Position is up from the lower stop; the scale's upper end is the upper stop, under the coil.

import { textOf } from "./texts.js";

const NS = "http://www.w3.org/2000/svg";
const TOP = 58, BOTTOM = 262, RADIUS = 24, MIDDLE = 104; // of the ball's centre at the stops, in the drawing's units

function add(parent, name, attributes, text) {
  const element = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

export class Ball {
  constructor(place) {
    this.travel = null;
    const svg = add(place, "svg", { viewBox: "0 0 220 310", role: "img", "aria-label": textOf("ball.picture") });
    add(svg, "rect", { x: MIDDLE - 44, y: 2, width: 88, height: 28, rx: 4, class: "coil" });
    for (let n = 0; n < 6; n++) add(svg, "line", { x1: MIDDLE - 36 + n * 14.4, y1: 4, x2: MIDDLE - 36 + n * 14.4, y2: 28, class: "winding" });
    add(svg, "text", { x: MIDDLE, y: 20, class: "coil-text", "text-anchor": "middle" }, textOf("ball.coil"));
    add(svg, "line", { x1: MIDDLE - 44, y1: TOP - RADIUS, x2: MIDDLE + 44, y2: TOP - RADIUS, class: "stop-line" });
    add(svg, "line", { x1: MIDDLE - 44, y1: BOTTOM + RADIUS, x2: MIDDLE + 44, y2: BOTTOM + RADIUS, class: "stop-line" });
    this.scale = add(svg, "g", { class: "scale" });
    this.twin = add(svg, "circle", { cx: MIDDLE, r: RADIUS, class: "twin" });
    this.ball = add(svg, "g", {});
    add(this.ball, "circle", { cx: MIDDLE, cy: 0, r: RADIUS, class: "ball" });
    add(this.ball, "line", { x1: MIDDLE - RADIUS - 6, x2: 184, y1: 0, y2: 0, class: "pointer" });
    this.reference = add(svg, "g", { class: "reference" });
    add(this.reference, "path", { d: "M 182 0 l 12 -7 v 14 z" });
    add(this.reference, "text", { x: 196, y: 4 }, textOf("ball.reference"));
    this.show(null, null, null);
  }

  setTravel(travel) {
    if (!(travel > 0) || travel === this.travel) return;
    this.travel = travel;
    this.scale.replaceChildren();
    add(this.scale, "line", { x1: 176, x2: 176, y1: TOP, y2: BOTTOM });
    for (let mm = 0; mm <= travel * 1e3 + 1e-6; mm++) {
      const y = this.height(mm * 1e-3);
      add(this.scale, "line", { x1: 171, x2: 181, y1: y, y2: y });
      if (mm % 2 === 0) add(this.scale, "text", { x: 166, y: y + 4, "text-anchor": "end" }, `${mm}`);
    }
    add(this.scale, "text", { x: 186, y: TOP + 4 }, "mm");
  }

  height(x) {
    return BOTTOM - Math.max(-0.03, Math.min(1.03, x / this.travel)) * (BOTTOM - TOP);
  }

  show(measured, twin, reference) {
    for (const [part, x] of [[this.ball, measured], [this.twin, twin], [this.reference, reference]]) {
      const there = x !== null && x !== undefined && this.travel !== null;
      part.style.display = there ? "" : "none";
      if (there) part.setAttribute("transform", `translate(0 ${this.height(x).toFixed(2)})`);
    }
  }
}
