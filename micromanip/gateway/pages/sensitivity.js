// |S| over frequency, on two logarithmic axes: as measured at its lines, and as predicted where there is a model.
import uPlot from "./third_party/uplot/uPlot.esm.js";
import { colour, element } from "./page.js";

const HEIGHT = 320;

export class SensitivityPlot {
  constructor(place) {
    this.place = place;
    this.plot = null;
    new ResizeObserver(() => this.plot?.setSize({ width: this.width, height: HEIGHT })).observe(place);
  }

  get width() {
    return Math.max(200, this.place.clientWidth - 12);
  }

  clear() {
    this.plot?.destroy();
    this.plot = null;
    this.place.replaceChildren(element("div", { className: "empty" }, "It is being measured."));
  }

  redraw() {
    this.plot?.redraw(false, true);
  }

  /** `found` as the gateway answers it. */
  draw(found) {
    const data = [found.frequency_Hz, found.sensitivity, found.sensitivity_predicted ?? found.frequency_Hz.map(() => null), found.frequency_Hz.map(() => found.measured.Ms)];
    this.plot?.destroy();
    this.place.replaceChildren();
    const axis = { stroke: () => colour("--faint"), grid: { stroke: () => colour("--grid"), width: 1 }, ticks: { stroke: () => colour("--grid") }, font: "13px system-ui, sans-serif", labelFont: "13px system-ui, sans-serif" };
    const series = (label, name, more = {}) => ({ label, stroke: () => colour(name), width: 1.5, points: { show: false }, ...more });
    const log = (plot, ticks) => ticks.map((tick) => (tick === null ? "" : String(tick)));
    this.plot = new uPlot({
      width: this.width,
      height: HEIGHT,
      scales: { x: { time: false, distr: 3 }, y: { distr: 3 } },
      axes: [{ ...axis, label: "Hz", size: 38, labelSize: 18, values: log }, { ...axis, label: "|S|", size: 62, labelSize: 18, values: log }],
      series: [{ label: "Hz" }, series("measured", "--trace-1", { points: { show: true, size: 5, fill: () => colour("--trace-1") } }), series("predicted", "--trace-2", { dash: [7, 4] }), series("Ms", "--bad", { dash: [2, 4] })],
    }, data, this.place);
  }
}
