// The traces over time: a panel for each unit, one below the other, with one time axis, cursors, states and limits.
import uPlot from "./third_party/uplot/uPlot.esm.js";
import { cell, colour, element, head, moment, padded, plainTicks, plotAxis, rows, seconds, short, swatch, timeTicks, unitText } from "./page.js";

const STATE_TINT = {
  READY: "#1f4e9922", ARMING: "#f0bd2120", TRACKING: "#0a8a3a1c", HOLDING: "#f0bd2120", RAMPING: "#f0bd2120", FAULT: "#d0202038",
};
const KEY = "scope";

export class Panels {
  /** A panel names its traces itself (`label`) where it `hasLegend`; else the readout below does.
   *
   * `zoomed(from, to)` hears of a drag and `wheel(at, factor)` of the wheel, in s; `pointed` of the pointer.
   */
  constructor(place, handlers, hasLegend = false) {
    Object.assign(this, { place, handlers, hasLegend, plots: [], key: "" });
    this.cursors = { A: null, B: null };
    this.pointer = null;
    this.shown = null;
    this.marks = [];
    new ResizeObserver(() => this.resize()).observe(place);
  }

  get points() {
    return Math.max(100, Math.min(2000, Math.round(this.place.clientWidth - 80)));
  }

  clear() {
    for (const plot of this.plots) plot.plot.destroy();
    this.plots = [];
    this.key = "";
    this.place.replaceChildren();
  }

  /** `fields` are {name, unit, colour}; made anew only where they have changed. */
  arrange(fields) {
    const key = fields.map((field) => field.name).join();
    if (key === this.key && this.plots.length) return;
    this.clear();
    this.key = key;
    if (!fields.length) {
      this.place.append(element("div", { className: "empty" }, "No field is chosen: choose some beside or below."));
      return;
    }
    const units = [...new Set(fields.map((field) => field.unit))];
    units.forEach((unit, i) => {
      const own = fields.filter((field) => field.unit === unit).reverse();  // a set-point comes first: above a noisy gauge
      if (this.hasLegend) this.place.append(legend([...own].reverse()));
      const plot = new uPlot(this.options(own, unit, i === units.length - 1, units.length), [[], ...own.map(() => [])], this.place);
      this.listen(plot);
      this.plots.push({ plot, own, unit, xs: [], ys: own.map(() => []) });
    });
  }

  height(panels) {
    const all = Math.max(260, Math.min(720, window.innerHeight - 330));
    return Math.max(120, Math.round(all / panels));
  }

  options(own, unit, isLast, panels) {
    const axis = plotAxis();
    return {
      width: Math.max(200, this.place.clientWidth - 10),
      height: this.height(panels) + (isLast ? 24 : 0),
      padding: [12, 18, isLast ? 0 : 10, 0],
      legend: { show: false },
      cursor: { sync: { key: KEY, scales: ["x", null] }, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, focus: { prox: 16 } },
      scales: { x: { time: false, range: () => this.shown ?? [0, 1] }, y: { range: (plot, low, high) => padded(low, high) } },
      axes: [
        { ...axis, show: isLast, size: 38, values: (plot, ticks) => timeTicks(ticks), space: 90 },
        { ...axis, size: 70, label: unitText(unit) || "number", values: plainTicks },
      ],
      series: [{}, ...own.map((field) => ({ label: field.name, stroke: () => colour(field.colour), width: 1.25, points: { show: false }, spanGaps: false }))],
      hooks: {
        drawClear: [(plot) => this.drawBands(plot, unit)],
        draw: [(plot) => this.drawCursors(plot)],
        setSelect: [(plot) => this.selected(plot)],
        setCursor: [(plot) => this.moved(plot)],
      },
    };
  }

  listen(plot) {
    plot.over.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.handlers.wheel?.(plot.posToVal(event.offsetX, "x"), event.deltaY < 0 ? 0.5 : 2);
    }, { passive: false });
    plot.over.addEventListener("dblclick", () => this.handlers.whole());
  }

  selected(plot) {
    if (plot.select.width < 4) return;
    this.handlers.zoomed?.(plot.posToVal(plot.select.left, "x"), plot.posToVal(plot.select.left + plot.select.width, "x"));
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
  }

  moved(plot) {
    const at = plot.cursor.left >= 0 ? plot.posToVal(plot.cursor.left, "x") : null;
    if (at === null && plot !== this.plots[0]?.plot) return;
    this.pointer = at;
    this.handlers.pointed?.(at);
  }

  /** Traces: `shown` is [from, to] in s, `times` (n) in s, `traces` {name: [low, high]}, `bands` [[from, to, state]]. */
  draw(shown, times, traces, bands, limits, trigger) {
    this.shown = shown;
    this.bands = bands;
    this.limits = limits;
    this.trigger = trigger;
    for (const panel of this.plots) {
      const isWhole = panel.own.every((field) => traces[field.name]?.[1] === undefined);
      doubled(panel.xs, times, times, isWhole);
      panel.own.forEach((field, i) => {
        const [low, high] = traces[field.name] ?? [[], undefined];
        doubled(panel.ys[i], low, high ?? low, isWhole);
      });
      panel.plot.setData([panel.xs, ...panel.ys]);
    }
  }

  redraw() {
    for (const { plot } of this.plots) plot.redraw(false, true);
  }

  drawBands(plot, unit) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const [from, to, state] of this.bands ?? []) {
      const [left, right] = within(plot, from, to);
      ctx.fillStyle = STATE_TINT[state] ?? "#80808018";
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
    }
    if (unit === "V") {
      ctx.strokeStyle = colour("--bad");
      ctx.setLineDash([6, 5]);
      for (const limit of this.limits ?? []) {
        const y = plot.valToPos(limit, "y", true);
        line(ctx, bbox.left, y, bbox.left + bbox.width, y);
      }
    }
    ctx.restore();
  }

  drawCursors(plot) {
    const { ctx, bbox } = plot;
    const lines = [...Object.entries(this.cursors), ["T", this.trigger]];
    ctx.save();
    ctx.font = `700 ${12 * devicePixelRatio}px system-ui, sans-serif`;
    ctx.textAlign = "left";
    ctx.textBaseline = "alphabetic";
    if (plot === this.plots[0]?.plot) this.nameBands(plot);
    this.drawMarks(plot);
    for (const [name, at] of lines) {
      if (at === null || at === undefined || !this.shown || at < this.shown[0] || at > this.shown[1]) continue;
      const x = plot.valToPos(at, "x", true);
      ctx.strokeStyle = ctx.fillStyle = colour(name === "T" ? "--bad" : "--text");
      ctx.setLineDash(name === "T" ? [2, 3] : [7, 4]);
      ctx.lineWidth = devicePixelRatio;
      line(ctx, x, bbox.top, x, bbox.top + bbox.height);
      ctx.fillText(name, x + 4 * devicePixelRatio, bbox.top + bbox.height - 6 * devicePixelRatio);
    }
    ctx.restore();
  }

  /** Faults, damage and remarks of a recording: a line each, named in the first panel where there is room. */
  drawMarks(plot) {
    const { ctx, bbox } = plot, isFirst = plot === this.plots[0]?.plot;
    let free = -Infinity;
    for (const [at, kind, text] of this.marks) {
      if (!this.shown || at < this.shown[0] || at > this.shown[1]) continue;
      const x = plot.valToPos(at, "x", true), tall = 18 * devicePixelRatio;
      ctx.strokeStyle = ctx.fillStyle = colour(kind === "mark" ? "--accent" : "--bad");
      ctx.setLineDash([]);
      ctx.lineWidth = 1.5 * devicePixelRatio;
      line(ctx, x, bbox.top, x, bbox.top + bbox.height);
      const width = ctx.measureText(text).width + 8;
      if (!isFirst || x < free || width > bbox.width / 2) continue;
      const left = x + width > bbox.left + bbox.width ? x - width - 2 : x + 2;
      if (left < free) continue;
      const ink = ctx.fillStyle;
      ctx.fillStyle = colour("--plot");
      ctx.fillRect(left, bbox.top + 1.2 * tall, width, tall);
      ctx.fillStyle = ink;
      ctx.fillText(text, left + 4, bbox.top + 2 * tall);
      free = x + width;
    }
  }

  nameBands(plot) {
    const { ctx, bbox } = plot;
    for (const [from, to, state] of this.bands ?? []) {
      const [left, right] = within(plot, from, to);
      const width = ctx.measureText(state).width;
      if (right - left < width + 10) continue;
      ctx.fillStyle = colour("--plot");
      ctx.fillRect(left + 3, bbox.top + 2, width + 6, 17 * devicePixelRatio);
      ctx.fillStyle = colour("--faint");
      ctx.fillText(state, left + 6, bbox.top + 14 * devicePixelRatio);
    }
  }

  resize() {
    const width = Math.max(200, this.place.clientWidth - 10);
    this.plots.forEach(({ plot }, i) => {
      const height = this.height(this.plots.length) + (i === this.plots.length - 1 ? 24 : 0);
      if (plot.width !== width || plot.height !== height) plot.setSize({ width, height });
    });
  }
}

/** Where a band from one time (s) to another is in the plot. */
function within(plot, from, to) {
  const { left, width } = plot.bbox;
  return [Math.max(left, plot.valToPos(from, "x", true)), Math.min(left + width, plot.valToPos(to, "x", true))];
}

function line(ctx, fromX, fromY, toX, toY) {
  ctx.beginPath();
  ctx.moveTo(fromX, fromY);
  ctx.lineTo(toX, toY);
  ctx.stroke();
}

function legend(fields) {
  return element("div", { className: "legend" }, ...fields.map((field) => element("span", {}, swatch(field), field.label)));
}

/** Into `target`, in place: every value, or least and greatest in turn; what is not known becomes a gap. */
function doubled(target, low, high, isWhole) {
  const n = low.length;
  target.length = isWhole ? n : 2 * n;
  for (let i = 0; i < n; i++) {
    if (isWhole) target[i] = Number.isNaN(low[i]) ? null : low[i];
    else {
      target[2 * i] = Number.isNaN(low[i]) ? null : low[i];
      target[2 * i + 1] = Number.isNaN(high[i]) ? null : high[i];
    }
  }
}

/** Figures of the traces under the pointer and the cursors. */
export function readout(table, fields, times, traces, pointer, cursors) {
  const at = (time) => (time === null ? -1 : nearest(times, time));
  const [now, a, b] = [at(pointer), at(cursors.A), at(cursors.B)];
  const value = (name, i) => (i < 0 ? null : middle(traces[name], i));
  const both = a >= 0 && b >= 0;
  const delta = both ? cursors.B - cursors.A : null;
  const of = (time) => (time === null ? "" : moment(time));
  const titles = ["trace", "unit", "least", "greatest", pointer === null ? "pointer" : of(pointer), `A ${of(cursors.A)}`, `B ${of(cursors.B)}`,
    both ? `B − A ${seconds(delta, 6)}, ${short(1 / Math.abs(delta))} Hz` : "B − A"];
  rows(table, [
    titles.map((title, i) => head(title, i > 1 ? "number" : "")),
    ...fields.map((field) => {
      const [low, high] = extremes(traces[field.name]);
      const [va, vb] = [value(field.name, a), value(field.name, b)];
      const name = cell("");
      name.append(swatch(field), field.name);
      const figures = [low, high, value(field.name, now), va, vb, both ? vb - va : null].map((figure) => cell(short(figure), "number"));
      figures.forEach((figure, i) => (figure.dataset.title = titles[i + 2]));  // where it is narrow, there is no head
      return [name, cell(unitText(field.unit)), ...figures];
    }),
  ]);
}

function nearest(times, time) {
  let low = 0, high = times.length - 1;
  if (high < 0) return -1;
  while (low < high) {
    const mid = (low + high) >> 1;
    if (times[mid] < time) low = mid + 1;
    else high = mid;
  }
  return low > 0 && time - times[low - 1] < times[low] - time ? low - 1 : low;
}

const middle = (trace, i) => (trace ? (trace[1] ? (trace[0][i] + trace[1][i]) / 2 : trace[0][i]) : null);

function extremes(trace) {
  let low = null, high = null;
  if (!trace) return [low, high];
  const [lows, highs] = [trace[0], trace[1] ?? trace[0]];
  for (let i = 0; i < lows.length; i++) {
    if (lows[i] < low || (low === null && !Number.isNaN(lows[i]))) low = lows[i];
    if (highs[i] > high || (high === null && !Number.isNaN(highs[i]))) high = highs[i];
  }
  return [low, high];
}
