// The spectrum of the last seconds, made by the server while this panel is open: see gateway/views/hmi/watch.py.

import { $, put } from "./dom.js";
import { Line } from "./line.js";
import { page } from "./server.js";
import { textOf } from "./texts.js";

/* global uPlot */

const DECADES = 5; // below the highest amplitude
const SERIES = [
  { column: "x", label: textOf("spectrum.x"), scale: "um", colour: "measured" },
  { column: "e", label: textOf("spectrum.residual"), scale: "um", colour: "twin", dash: [7, 4] },
  { column: "i", label: textOf("spectrum.current"), scale: "mA", colour: "input", dash: [2, 3] },
];
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const panel = document.querySelector("details.spectrum"), place = $("spectrum");
let line = null, plot = null;

panel.addEventListener("toggle", () => {
  line?.end();
  line = panel.open ? new Line(`${page.live}/spectrum`, (frame) => show(frame.spectra)) : null;
  if (line) show(undefined);
});

function show(spectra) {
  put("spectrum-said", spectra ? spectra.said : textOf("spectrum.waiting"));
  put("spectrum-highest", spectra?.highest ?? "");
  plot ??= new uPlot(settings(), [[]], place);
  plot.setSize({ width: place.clientWidth, height: place.clientHeight - (place.querySelector(".u-legend")?.offsetHeight ?? 0) });
  const f = spectra?.f_hz ?? [];
  plot.setData([f, ...SERIES.map(({ column }) => spectra?.[column] ?? f.map(() => null))]);
  const title = spectra?.span_s ? textOf("spectrum.seen", { seconds: spectra.span_s }) : "";
  place.querySelector(".u-legend .u-label").textContent = place.ariaLabel = title;
}

function settings() {
  const decades = (u, low, high) => {
    if (!(high > 0)) return [0.1, 10];
    const top = 10 ** Math.ceil(Math.log10(high * 1.2));
    return [Math.max(10 ** Math.floor(Math.log10(low)), top / 10 ** DECADES), top];
  };
  const axis = (scale, label, more) => ({
    scale, label, labelSize: 18, labelGap: 0, font: "12px system-ui", labelFont: "12px system-ui",
    stroke: () => css("muted"), grid: { stroke: () => css("edge"), width: 1, filter: more.filter }, ticks: { show: false }, ...more,
  });
  // A line of the grid with each number; all of them together would hide the curves.
  const only = (digits) => (u, at) => at.map((v) => (v !== null && digits.includes(v.toExponential()[0]) ? v : null));
  const words = (u, at) => at.map((v) => (v === null ? "" : `${Number(v.toPrecision(1))}`));
  const amplitude = { filter: only("1"), values: words, size: 56 };
  const shown = (value) => (value == null ? "" : `${Number(value.toPrecision(3))}`);
  return {
    width: 300, height: 200,
    scales: {
      x: { time: false, distr: 3, range: (u, low, high) => (high > 0 ? [low, high] : [0.2, 250]) },
      um: { distr: 3, range: decades }, mA: { distr: 3, range: decades },
    },
    axes: [
      axis("x", textOf("spectrum.frequency"), { filter: (u, at) => only(u.width < 500 ? "1" : "125")(u, at), values: words, size: 24 }),
      axis("um", textOf("spectrum.position_axis"), amplitude),
      axis("mA", textOf("spectrum.current_axis"), { ...amplitude, side: 1, grid: { show: false } }),
    ],
    series: [{ value: (u, f) => (f == null ? "" : `${shown(f)} Hz`) },
             ...SERIES.map(({ label, scale, colour, dash }) => ({
               label, scale, dash, stroke: () => css(colour), width: 1.5, points: { show: false }, value: (u, v) => shown(v),
             }))],
    cursor: { drag: { x: true, y: false }, points: { size: 5 } },
  };
}

new ResizeObserver(() => plot && panel.open && plot.setSize({ width: place.clientWidth, height: plot.height })).observe(place);
