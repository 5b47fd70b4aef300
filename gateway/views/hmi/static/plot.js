// One plot over time, drawn by uPlot: bands from the lowest to the highest sample of a bin, so that no spike is lost.
//
// A series is {kind, low, high, name, scale, factor, style, dash, width, fill, digits}: which rows it reads and at which places
// of a row its low and high are.  A gap, or a new session, is a gap in the line.

import { cell } from "./dom.js";
import { textOf } from "./texts.js";

/* global uPlot */

const GAP_S = 0.25, COARSE_GAP_S = 5;
const MOMENT = { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false, fractionalSecondDigits: 2 };
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

export class Plot {
  // options: {title, axes: [{scale, label, side, log, floor, minSpan}], series}; `changed(u)` is called after a zoom.
  constructor(place, options, changed) {
    this.place = place;
    this.options = options;
    this.lost = "";
    this.marks = [];
    this.line = null; // of the alarm, on the scale of the last axis
    this.kept = {};
    place.setAttribute("role", "group");
    this.u = new uPlot(this.settings(changed), [[]], place);
    this.named = place.querySelector(".u-legend").appendChild(cell("caption", "", "alarm-line")); // a name in the plot would lie on lines
    new ResizeObserver(() => this.fit()).observe(place);
    this.fit();
  }

  // value: where the alarm begins, or null.
  alarmAt(value) {
    if (this.line === value) return;
    this.line = value;
    this.named.textContent = value === null ? "" : textOf("plots.alarm_line", { value: Number(value.toPrecision(3)) });
    this.fit();
  }

  fit() {
    const legend = this.place.querySelector(".u-legend")?.offsetHeight ?? 0, width = this.place.clientWidth;
    const height = this.place.clientHeight - legend;
    this.isShown = width > 40 && height > 40;
    if (this.isShown) this.u.setSize({ width, height });
  }

  settings(changed) {
    const { axes, series, title } = this.options;
    const scales = { x: { time: true, auto: false } };
    for (const axis of axes) {
      scales[axis.scale] = { distr: axis.log ? 3 : 1, range: (u, low, high) => this.range(axis, low, high) };
    }
    const x = { stroke: () => css("muted"), grid: { stroke: () => css("edge"), width: 1 }, ticks: { show: false },
                values: (u, at) => at.map((t) => new Date(t * 1000).toLocaleTimeString([], { hour12: false })), space: 90, size: 24 };
    return {
      width: 300, height: 150, scales, tzDate: (t) => new Date(t * 1000), ms: 1e-3,
      axes: [x, ...axes.map((axis, n) => ({
        scale: axis.scale, label: axis.label, labelSize: 16, labelGap: 0, size: 48, side: axis.side ?? 3, font: "12px system-ui", labelFont: "12px system-ui",
        stroke: () => css("muted"), grid: { show: n === 0, stroke: () => css("edge"), width: 1 }, ticks: { show: false },
        ...(axis.log ? { values: (u, at) => at.map((v) => (Math.abs(Math.log10(v) % 1) < 1e-6 ? `${v}` : "")) } : {}),
      }))],
      series: [{ label: title, value: (u, t) => (t == null ? "" : new Date(t * 1000).toLocaleTimeString([], MOMENT)) },
               ...series.flatMap((one) => this.lines(one))],
      bands: series.map((one, n) => ({ series: [2 * n + 2, 2 * n + 1], fill: () => css(one.style) + (one.fill ?? "55") })),
      cursor: { sync: { key: "rig" }, drag: { x: true, y: false }, points: { size: 5 }, focus: { prox: -1 } },
      legend: { live: true },
      hooks: { drawClear: [(u) => this.ground(u)], draw: [(u) => this.over(u)], setSelect: [(u) => u.select.width > 4 && changed(u)] },
    };
  }

  lines(one) {
    const line = { scale: one.scale, stroke: () => css(one.style), width: one.width ?? 1.6, dash: one.dash, points: { show: false },
                   value: (u, v) => (v == null ? "" : v.toFixed(one.digits ?? 3)) };
    return [{ ...line, label: one.name }, { ...line, label: textOf("plots.highest", { name: one.name }), class: "highest" }];
  }

  // The scale follows at once outwards and only when much is empty inwards: a jumping scale cannot be read.
  range(axis, low, high) {
    if (low === null || low === undefined || !isFinite(low)) [low, high] = axis.log ? [1, 1] : [0, 0];
    if (this.line !== null && axis.alarm) high = Math.max(high, this.line);
    if (axis.log) return [axis.floor, 10 ** Math.ceil(Math.log10(Math.max(high * 1.5, 10)))];
    const span = Math.max(high - low, axis.minSpan), middle = (low + high) / 2;
    let bounds = [middle - span * 0.58, middle + span * 0.58];
    if (axis.floor !== undefined && bounds[0] < axis.floor) bounds = [axis.floor, Math.max(bounds[1], axis.floor + span * 1.16)];
    const kept = this.kept[axis.scale];
    if (kept && bounds[0] >= kept[0] && bounds[1] <= kept[1] && bounds[1] - bounds[0] > 0.45 * (kept[1] - kept[0])) return kept;
    return (this.kept[axis.scale] = bounds);
  }

  // history: see history.js; from, to: board time; offset: what makes clock time of it, s.
  draw(history, from, to, offset) {
    const kinds = [...new Set(this.options.series.map((one) => one.kind))];
    const tables = kinds.map((kind) => this.table(kind, history.since(kind, from - 1), offset));
    const joined = kinds.length > 1 ? uPlot.join(tables) : tables[0];
    // uPlot.join puts the columns kind by kind; the series may stand in another order.
    const order = kinds.flatMap((kind) => this.options.series.filter((one) => one.kind === kind));
    const data = [joined[0]];
    for (const one of this.options.series) {
      const at = 1 + 2 * order.indexOf(one);
      data.push(joined[at] ?? [], joined[at + 1] ?? []);
    }
    this.u.batch(() => {
      this.u.setData(data, false);
      this.u.setScale("x", { min: from + offset, max: to + offset });
    });
  }

  table(kind, rows, offset) {
    const series = this.options.series.filter((one) => one.kind === kind), table = [[], ...series.flatMap(() => [[], []])];
    let last = null;
    const add = (t, values) => {
      table[0].push(t);
      values.forEach((value, n) => table[n + 1].push(value));
    };
    const scaled = (value, one) => (value === null || value === undefined ? null : value * (one.factor ?? 1));
    for (const row of rows) {
      const gap = last && row[2] - last[2];
      if (last && gap <= 0) continue;
      if (last && (row[1] !== last[1] || gap > (last[2] < rows.at(-1)[2] - 20 ? COARSE_GAP_S : GAP_S))) {
        add(last[2] + offset + gap / 2, series.flatMap(() => [null, null]));
      }
      add(row[2] + offset, series.flatMap((one) => [scaled(row[one.low], one), scaled(row[one.high], one)]));
      last = row;
    }
    return table;
  }

  ground(u) {
    const band = this.options.noise;
    if (!band) return;
    const { left, width, top: highest, height } = u.bbox, inside = (y) => Math.min(Math.max(y, highest), highest + height);
    const [top, bottom] = [band.high, band.low].map((value) => inside(u.valToPos(value, band.scale, true)));
    u.ctx.fillStyle = "#7f8f9b33";
    u.ctx.fillRect(left, top, width, bottom - top);
  }

  over(u) {
    const { left, top, width, height } = u.bbox, g = u.ctx, ratio = devicePixelRatio;
    g.save();
    g.beginPath();
    g.rect(left, top, width, height);
    g.clip();
    g.font = `${11 * ratio}px system-ui, sans-serif`;
    const rule = (from, to, style, dash) => {
      g.strokeStyle = g.fillStyle = style;
      g.lineWidth = 1.2 * ratio;
      g.setLineDash(dash.map((d) => d * ratio));
      g.beginPath();
      g.moveTo(...from);
      g.lineTo(...to);
      g.stroke();
      g.setLineDash([]);
    };
    if (this.line !== null) {
      const axis = this.options.axes.at(-1), y = u.valToPos(this.line, axis.scale, true);
      rule([left, y], [left + width, y], css("bad"), [10, 4, 2, 4]);
    }
    g.textAlign = "left";
    let free = left - 1; // names must not lie on one another
    for (const mark of this.marks) {
      const x = u.valToPos(mark.at_s, "x", true);
      if (x < left || x > left + width) continue;
      rule([x, top], [x, top + height], mark.severity === "info" ? css("muted") : css("bad"), [3, 3]);
      const length = g.measureText(mark.name).width, begin = Math.min(x + 3 * ratio, left + width - length);
      if (begin < free) continue;
      g.fillText(mark.name, begin, top + 11 * ratio);
      free = begin + length + 10 * ratio;
    }
    if (this.lost) this.curtain(g, left, top, width, height, ratio);
    g.restore();
  }

  curtain(g, left, top, width, height, ratio) {
    g.fillStyle = css("curtain");
    g.fillRect(left, top, width, height);
    g.fillStyle = css("bad");
    g.font = `600 ${15 * ratio}px system-ui, sans-serif`;
    g.textAlign = "center";
    g.textBaseline = "middle";
    const wide = g.measureText(this.lost).width > width, lines = wide ? this.lost.split(" \u2013 ") : [this.lost];
    const middle = top + height / 2 - 10 * ratio * (lines.length - 1);
    lines.forEach((line, n) => g.fillText(line, left + width / 2, middle + 20 * ratio * n));
  }
}
