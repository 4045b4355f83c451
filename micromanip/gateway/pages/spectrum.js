// Amplitude densities on two logarithmic axes, and the greatest lines of each trace.
import uPlot from "./third_party/uplot/uPlot.esm.js";
import { colour, element, short, unitText } from "./page.js";

export class SpectrumView {
  constructor(place) {
    this.place = place;
    this.plot = null;
    this.key = "";
  }

  clear() {
    this.plot?.destroy();
    this.plot = null;
    this.key = "";
    this.place.replaceChildren();
  }

  /** `header` and `arrays` as the gateway sends them; `fields` are {name, unit, colour}. */
  draw(header, arrays, fields) {
    const own = fields.filter((field) => arrays[field.name]);
    if (!own.length) {
      this.clear();
      this.place.append(element("div", { className: "empty" }, "Too few samples for a spectrum: choose a longer time."));
      return;
    }
    const frequency = Array.from(arrays.frequency_Hz.subarray(1));
    const data = [frequency, ...own.map((field) => Array.from(arrays[field.name].subarray(1), (value) => (value > 0 ? value : null)))];
    const key = own.map((field) => field.name).join();
    if (this.plot && key === this.key) {
      this.plot.setData(data);
      return;
    }
    this.clear();
    this.key = key;
    const units = [...new Set(own.map((field) => unitText(field.unit) || "1"))].map((unit) => `${unit}/√Hz`).join(", ");
    const axis = { stroke: () => colour("--faint"), grid: { stroke: () => colour("--grid"), width: 1 }, ticks: { stroke: () => colour("--grid") }, font: "13px system-ui, sans-serif", labelFont: "13px system-ui, sans-serif" };
    const power = (plot, ticks) => ticks.map((tick) => (tick === null ? "" : tick >= 0.01 && tick < 1e5 ? String(tick) : tick.toExponential(0).replaceAll("-", "−")));
    this.plot = new uPlot({
      width: Math.max(200, this.place.clientWidth - 10),
      height: Math.max(280, Math.min(720, window.innerHeight - 310)),
      legend: { show: false },
      cursor: { drag: { x: true, y: false } },
      scales: { x: { time: false, distr: 3 }, y: { distr: 3 } },
      axes: [{ ...axis, label: "Hz", size: 38, labelSize: 18, values: power }, { ...axis, label: units, size: 70, labelSize: 18, values: power }],
      series: [{}, ...own.map((field) => ({ label: field.name, stroke: () => colour(field.colour), width: 1.25, points: { show: false } }))],
    }, data, this.place);
  }

  resize() {
    this.plot?.setSize({ width: Math.max(200, this.place.clientWidth - 10), height: this.plot.height });
  }
}

export function lines(table, header, fields, make) {
  make.rows(table, [
    [make.head("trace"), make.head("greatest lines: frequency and peak amplitude")],
    ...fields.filter((field) => header.lines[field.name]).map((field) => {
      const swatch = element("span", { className: "swatch" });
      swatch.style.background = colour(field.colour);
      const name = make.cell("");
      name.append(swatch, field.name);
      const found = header.lines[field.name].map(([f, a]) => `${short(f)} Hz: ${short(a)} ${unitText(field.unit)}`);
      return [name, make.cell(found.join("   ·   ") || "none stands out")];
    }),
  ]);
}
