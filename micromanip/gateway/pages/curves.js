// Curves that are not over time: amplitude densities with their greatest lines, x-y.
import uPlot from "./third_party/uplot/uPlot.esm.js";
import { cell, colour, element, head, padded, plainTicks, plotAxis, rows, short, swatch, unitText } from "./page.js";

const power = (plot, ticks) => ticks.map((tick) => (tick === null ? "" : tick >= 0.01 && tick < 1e5 ? String(tick) : tick.toExponential(0).replaceAll("-", "−")));
const tall = () => Math.max(280, Math.min(720, window.innerHeight - 310));

/** One plot in `place`. */
class Curves {
  plot = null;

  constructor(place) {
    this.place = place;
  }

  get width() {
    return Math.max(200, this.place.clientWidth - 12);
  }

  clear(text = "") {
    this.plot?.destroy();
    this.plot = null;
    this.place.replaceChildren(...(text ? [element("div", { className: "empty" }, text)] : []));
  }

  /** `data` and `series` as uPlot has them, with colours by name; `labels` of x and y; `more` options of uPlot. */
  make(data, series, labels, values, more) {
    this.clear();
    const axis = { ...plotAxis(), values };
    this.plot = new uPlot({
      width: this.width,
      height: tall(),
      axes: [{ ...axis, label: labels[0], size: 38 }, { ...axis, label: labels[1], size: 70 }],
      series: [{ label: labels[0] }, ...series.map((one) => ({ width: 1.25, points: { show: false }, ...one, stroke: () => colour(one.colour) }))],
      ...more,
    }, data, this.place);
  }

  redraw() {
    this.plot?.redraw(false, true);
  }

  resize() {
    this.plot?.setSize({ width: this.width, height: this.plot.height });
  }
}

/** On two logarithmic axes, over Hz. */
export class SpectrumView extends Curves {
  key = "";

  /** `header` and `arrays` as the gateway sends them; `fields` are {name, unit, colour}. */
  draw(arrays, fields) {
    const own = fields.filter((field) => arrays[field.name]);
    if (!own.length) {
      this.clear("Too few samples for a spectrum: choose a longer time.");
      return;
    }
    const data = [Array.from(arrays.frequency_Hz.subarray(1)), ...own.map((field) => Array.from(arrays[field.name].subarray(1), (value) => (value > 0 ? value : null)))];
    const key = own.map((field) => field.name).join();
    if (this.plot && key === this.key) {
      this.plot.setData(data);
      return;
    }
    this.key = key;
    const units = [...new Set(own.map((field) => unitText(field.unit) || "1"))].map((unit) => `${unit}/√Hz`).join(", ");
    this.make(data, own.map((field) => ({ label: field.name, colour: field.colour })), ["Hz", units], power,
      { legend: { show: false }, cursor: { drag: { x: true, y: false } }, scales: { x: { time: false, distr: 3 }, y: { distr: 3 } } });
  }

  /** The greatest lines of each trace, into `table`. */
  list(table, header, fields) {
    rows(table, [
      [head("trace"), head("greatest lines: frequency and peak amplitude")],
      ...fields.filter((field) => header.lines[field.name]).map((field) => {
        const name = cell("");
        name.append(swatch(field), field.name);
        const found = header.lines[field.name].map(([f, a]) => `${short(f)} Hz: ${short(a)} ${unitText(field.unit)}`);
        return [name, cell(found.join("   ·   ") || "none stands out")];
      }),
    ]);
  }
}

/** One field over another, such as a hysteresis loop. */
export class XyView extends Curves {
  draw(x, y, xField, yField) {
    const named = ({ name, unit }) => (unit ? `${name}, ${unitText(unit)}` : name);
    const facets = ["x", "y"].map((scale) => ({ scale, auto: true }));
    this.make([null, [x, y]], [{ colour: "--trace-1", facets, paths: polyline }], [named(xField), named(yField)], plainTicks,
      { mode: 2, legend: { show: false }, cursor: { show: false }, scales: { x: { time: false, range: ends(x) }, y: { range: ends(y) } } });
  }
}

function ends(values) {
  const known = values.filter(Number.isFinite);
  return known.length ? padded(Math.min(...known), Math.max(...known)) : padded(null, null);
}

/** Through the points in their order; what is not known is a gap. */
function polyline(plot, series) {
  const stroke = new Path2D(), [x, y] = plot.data[series];
  let drawing = false;
  for (let i = 0; i < x.length; i++) {
    const known = Number.isFinite(x[i]) && Number.isFinite(y[i]);
    if (known) stroke[drawing ? "lineTo" : "moveTo"](plot.valToPos(x[i], "x", true), plot.valToPos(y[i], "y", true));
    drawing = known;
  }
  return { stroke };
}
