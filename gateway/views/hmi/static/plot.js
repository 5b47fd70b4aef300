// A scrolling plot of min / max bins on a canvas: the last seconds, newest at the right.
//
// A series is {kind, low, high, name, unit, style, fill, dash, width}: which row kind it reads and at which places of the
// row its low and high are.  low === high draws a line; otherwise the band between them is filled, so that a spike of a
// single sample is seen.

export const SPAN_S = 20;

const INK = "#1d2b36", GRID = "#d5dbe0", MUTED = "#5a6872", ALARM = "#b3261e";

function niceStep(span, target) {
  const raw = span / target, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((n) => n * power >= raw);
}

export class Plot {
  // options: {title, unit, scale (display units per SI unit), series, minSpan, floor, log}; `line` is the alarm line or null
  constructor(canvas, options) {
    this.canvas = canvas;
    this.options = options;
    this.range = null;
    this.line = null;
    canvas.setAttribute("role", "img");
  }

  // rows: {kind: [row, ...]} in order of time; now: board time at the right edge; lost: words for missing data or "";
  // at: clock time of the newest sample, which is the right edge where data are missing.
  draw(rows, now, lost, at) {
    const ratio = window.devicePixelRatio || 1, box = this.canvas.getBoundingClientRect();
    if (box.width < 20 || box.height < 20) return;
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    const edge = lost ? at || "no sample" : "now", about = `${this.options.title}, ${SPAN_S} seconds up to ${edge}`;
    if (this.canvas.ariaLabel !== about) this.canvas.ariaLabel = about;
    const g = this.canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, box.width, box.height);
    const area = { left: 54, right: box.width - 10, top: 26, bottom: box.height - 20 };
    const scale = this.options.scale ?? 1;
    const [low, high] = this.fit(rows, now, scale);
    const x = (t) => area.right - ((now - t) / SPAN_S) * (area.right - area.left);
    const share = this.options.log
      ? (v) => Math.log(Math.max(v, low) / low) / Math.log(high / low)
      : (v) => (v - low) / (high - low);
    const y = (v) => area.bottom - share(v) * (area.bottom - area.top);
    this.axes(g, area, low, high, x, y, now, edge);
    g.save();
    g.beginPath();
    g.rect(area.left, area.top, area.right - area.left, area.bottom - area.top);
    g.clip();
    if (this.line !== null && this.line * scale < high) this.alarmLine(g, area, y(this.line * scale));
    for (const series of this.options.series) this.trace(g, rows[series.kind] ?? [], series, now, scale, x, y);
    g.restore();
    this.legend(g, area);
    if (lost) this.curtain(g, area, lost);
  }

  fit(rows, now, scale) {
    let low = Infinity, high = -Infinity;
    for (const s of this.options.series) {
      for (const row of rows[s.kind] ?? []) {
        if (row[2] < now - SPAN_S) continue;
        if (row[s.low] !== null && row[s.low] < low) low = row[s.low];
        if (row[s.high] !== null && row[s.high] > high) high = row[s.high];
      }
    }
    if (low > high) [low, high] = [0, 0];
    low *= scale;
    high *= scale;
    if (this.line !== null) high = Math.max(high, this.line * scale);
    if (this.options.log) return [this.options.floor, 10 ** Math.ceil(Math.log10(Math.max(high * 1.5, 10)))];
    const span = Math.max(high - low, this.options.minSpan), middle = (low + high) / 2;
    low = middle - span * 0.58;
    high = middle + span * 0.58;
    if (this.options.floor !== undefined && low < this.options.floor) {
      high = Math.max(high, this.options.floor + span * 1.16);
      low = this.options.floor;
    }
    // The scale follows at once outwards and only when much is empty inwards: a jumping scale cannot be read.
    const kept = this.range;
    if (kept && low >= kept[0] && high <= kept[1] && high - low > 0.45 * (kept[1] - kept[0])) return kept;
    this.range = [low, high];
    return this.range;
  }

  ticks(area, low, high) {
    if (this.options.log) {
      const values = [];
      for (let v = 10 ** Math.ceil(Math.log10(low)); v <= high * 1.001; v *= 10) values.push([v, v < 1 ? v.toFixed(1) : v.toFixed(0)]);
      return values;
    }
    const step = niceStep(high - low, Math.max(2, Math.min(6, (area.bottom - area.top) / 34)));
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), values = [];
    for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + step * 1e-6; v += step)
      values.push([v, (Math.abs(v) < step / 2 ? 0 : v).toFixed(digits)]);
    return values;
  }

  axes(g, area, low, high, x, y, now, edge) {
    g.font = "12px system-ui, sans-serif";
    g.lineWidth = 1;
    g.strokeStyle = GRID;
    g.fillStyle = MUTED;
    g.textBaseline = "middle";
    g.textAlign = "right";
    for (const [v, text] of this.ticks(area, low, high)) {
      const at = Math.round(y(v)) + 0.5;
      g.beginPath();
      g.moveTo(area.left, at);
      g.lineTo(area.right, at);
      g.stroke();
      g.fillText(text, area.left - 6, at);
    }
    g.textBaseline = "top";
    for (let s = 0; s <= SPAN_S; s += 5) {
      const at = Math.round(x(now - s)) + 0.5;
      g.beginPath();
      g.moveTo(at, area.top);
      g.lineTo(at, area.bottom);
      g.stroke();
      if (s > 0 && area.right - at < g.measureText(edge).width + 30) continue; // the label at the edge takes its place
      g.textAlign = s === 0 ? "right" : s === SPAN_S ? "left" : "center";
      g.fillText(s === 0 ? edge : `\u2212${s} s`, at, area.bottom + 5);
    }
    g.strokeStyle = MUTED;
    g.strokeRect(area.left + 0.5, area.top + 0.5, area.right - area.left, area.bottom - area.top);
  }

  trace(g, rows, series, now, scale, x, y) {
    g.strokeStyle = g.fillStyle = series.style;
    g.lineWidth = series.width ?? 1.6;
    g.setLineDash(series.dash ?? []);
    g.lineJoin = "round";
    let begun = false, session = null, last = -Infinity;
    g.beginPath();
    for (const row of rows) {
      const t = row[2], low = row[series.low], high = row[series.high];
      if (t < now - SPAN_S - 1) continue;
      if (low === null || high === null) {
        begun = false;
        continue;
      }
      if (row[1] !== session || t - last > 0.25) begun = false; // a gap stays a gap
      session = row[1];
      last = t;
      const at = x(t), top = y(high * scale), bottom = y(low * scale);
      if (!begun) g.moveTo(at, bottom);
      else g.lineTo(at, bottom);
      if (bottom - top > 0.5) g.lineTo(at, top);
      begun = true;
    }
    g.stroke();
    g.setLineDash([]);
  }

  alarmLine(g, area, at) {
    g.strokeStyle = g.fillStyle = ALARM;
    g.lineWidth = 1.5;
    g.setLineDash([10, 4, 2, 4]);
    g.beginPath();
    g.moveTo(area.left, at);
    g.lineTo(area.right, at);
    g.stroke();
    g.setLineDash([]);
    g.font = "12px system-ui, sans-serif";
    g.textAlign = "right";
    g.textBaseline = "bottom";
    g.fillText("alarm line", area.right - 6, at - 2);
  }

  legend(g, area) {
    g.textBaseline = "middle";
    g.textAlign = "left";
    const narrow = area.right < 480, dash = narrow ? 14 : 22, gap = narrow ? 9 : 16;
    g.font = `600 ${narrow ? 12 : 13}px system-ui, sans-serif`;
    g.fillStyle = INK;
    const title = this.options.title + (this.options.unit ? `, ${this.options.unit}` : "");
    g.fillText(title, area.left - 46, 12);
    let at = area.left - 46 + g.measureText(title).width + gap;
    g.font = `${narrow ? 11 : 12}px system-ui, sans-serif`;
    for (const series of this.options.series) {
      const length = g.measureText(series.name).width;
      if (at + dash + 5 + length > area.right + 8) return;
      g.strokeStyle = series.style;
      g.lineWidth = Math.max(2, series.width ?? 2);
      g.setLineDash(series.dash ?? []);
      g.beginPath();
      g.moveTo(at, 12);
      g.lineTo(at + dash, 12);
      g.stroke();
      g.setLineDash([]);
      g.fillStyle = MUTED;
      g.fillText(series.name, at + dash + 5, 12);
      at += dash + 5 + length + gap;
    }
  }

  curtain(g, area, text) {
    g.fillStyle = "rgba(240, 242, 244, 0.78)";
    g.fillRect(area.left, area.top, area.right - area.left, area.bottom - area.top);
    g.fillStyle = ALARM;
    g.font = "600 15px system-ui, sans-serif";
    g.textAlign = "center";
    g.textBaseline = "middle";
    const wide = g.measureText(text).width > area.right - area.left, lines = wide ? text.split(" \u2013 ") : [text];
    const middle = (area.top + area.bottom) / 2 - 10 * (lines.length - 1);
    lines.forEach((line, n) => g.fillText(line, (area.left + area.right) / 2, middle + 20 * n));
  }
}
