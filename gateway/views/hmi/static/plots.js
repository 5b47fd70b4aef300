// The plots of a rig's page: position, current and input, residual and divergence; span, pause, zoom.

import { $, put } from "./dom.js";
import { Plot } from "./plot.js";
import { textOf } from "./texts.js";

const MEASURED = "measured", TWIN = "twin", REFERENCE = "reference", INPUT = "input"; // colours of hmi.css
const DASH = [7, 4];

const PLOTS = {
  "plot-x": {
    title: textOf("plots.position"), axes: [{ scale: "mm", label: "mm", minSpan: 0.4, floor: -0.15 }],
    series: [
      { kind: "s", low: 3, high: 4, name: textOf("plots.measured"), scale: "mm", factor: 1e3, style: MEASURED },
      { kind: "t", low: 3, high: 4, name: textOf("plots.twin"), scale: "mm", factor: 1e3, style: TWIN, dash: DASH, width: 1.8 },
      { kind: "s", low: 5, high: 5, name: textOf("plots.reference"), scale: "mm", factor: 1e3, style: REFERENCE, dash: [2, 3], width: 2 },
    ],
  },
  "plot-i": {
    title: textOf("plots.current"),
    axes: [{ scale: "A", label: "A", minSpan: 0.1, floor: -0.05 }, { scale: "V", label: "V", minSpan: 0.3, floor: -0.15, side: 1 }],
    series: [
      { kind: "s", low: 8, high: 9, name: textOf("plots.input"), scale: "V", style: INPUT, width: 1.1, dash: [1, 2], fill: "22" },
      { kind: "s", low: 6, high: 7, name: textOf("plots.current_measured"), scale: "A", style: MEASURED },
      { kind: "t", low: 5, high: 6, name: textOf("plots.current_twin"), scale: "A", style: TWIN, dash: DASH, width: 1.8 },
    ],
  },
  "plot-d": {
    title: textOf("plots.residual"), noise: { scale: "sigma", low: -2, high: 2 },
    axes: [{ scale: "sigma", label: textOf("plots.residual_axis"), minSpan: 8 },
           { scale: "NIS", label: textOf("plots.nis_axis"), log: true, floor: 0.5, side: 1, alarm: true }],
    series: [
      { kind: "d", low: 3, high: 4, name: textOf("plots.residual_line"), scale: "sigma", style: MEASURED, digits: 1 },
      { kind: "d", low: 5, high: 5, name: textOf("plots.nis_line"), scale: "NIS", style: TWIN, width: 2, digits: 2 },
    ],
  },
};

export class Plots {
  constructor(history) {
    this.history = history;
    this.span = 20;
    this.paused = false;
    this.offset = 0;
    this.plots = Object.fromEntries(
      Object.entries(PLOTS).map(([name, options]) => [name, new Plot($(name), options, () => this.pause(true))]),
    );
    for (const button of document.querySelectorAll("[data-span]")) {
      button.addEventListener("click", () => this.show(Number(button.dataset.span)));
    }
    this.button = document.querySelector("[data-pause]");
    this.button.addEventListener("click", () => this.pause(!this.paused));
    for (const plot of Object.values(this.plots)) plot.u.over.addEventListener("dblclick", () => this.pause(false));
    const { timeZone } = Intl.DateTimeFormat().resolvedOptions();
    put("plots-zone", textOf("plots.zone", { zone: timeZone }));
    const wanted = Number(new URLSearchParams(location.hash.slice(1)).get("span")); // a link may say it
    this.show(document.querySelector(`[data-span="${wanted}"]`) ? wanted : 20);
  }

  show(span) {
    this.span = span;
    if (span !== 20 || location.hash) history.replaceState(null, "", `#span=${span}`);
    for (const button of document.querySelectorAll("[data-span]")) {
      button.setAttribute("aria-pressed", String(Number(button.dataset.span) === span));
    }
    this.pause(false);
  }

  pause(wanted) {
    this.paused = wanted;
    this.button.textContent = wanted ? textOf("plots.go_on") : textOf("plots.pause");
    this.button.setAttribute("aria-pressed", String(wanted));
  }

  // at: board time at the right edge; now: the newest values; lost: why they are not true now, or "".
  draw(at, now, lost, marks) {
    if (now?.host_s && now.t_s !== undefined) {
      const offset = now.host_s - now.t_s;
      if (Math.abs(offset - this.offset) > 0.2) this.offset = offset; // else the lines would tremble
    }
    const time = lost ? now?.at || textOf("plots.no_sample") : textOf("plots.now");
    for (const [name, plot] of Object.entries(this.plots)) {
      const about = textOf("plots.about", { plot: PLOTS[name].title, seconds: this.span, time });
      if (plot.place.ariaLabel !== about) plot.place.ariaLabel = about;
      if (!plot.isShown || (this.paused && plot.lost === lost)) continue; // a tab of a narrow screen may hide it
      plot.lost = lost;
      plot.marks = marks;
      if (name === "plot-d") plot.alarmAt(now?.nis_on ?? null);
      if (this.paused) plot.u.redraw();
      else plot.draw(this.history, at - this.span, at, this.offset);
    }
  }
}
