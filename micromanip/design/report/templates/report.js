"use strict";
(() => {
  const GAP = 65535;
  const NAME = "http://www.w3.org/2000/svg";
  const PAD = { left: 58, right: 12, top: 8, bottom: 26 };

  const element = (name, attributes, parent) => {
    const made = document.createElementNS(NAME, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return parent.appendChild(made);
  };

  // points as they are seen: logarithms on a logarithmic axis
  const points = (curve, span) => {
    const bytes = Uint8Array.from(atob(curve.points), (each) => each.charCodeAt(0));
    const words = new Uint16Array(bytes.buffer);
    const count = words.length / 2;
    const place = (k, axis) => span[axis][0] + (words[k + axis * count] / (GAP - 1)) * (span[axis][1] - span[axis][0]);
    return Array.from({ length: count }, (_, k) => (words[k] === GAP ? null : [place(k, 0), place(k, 1)]));
  };

  const told = (value, log) => {
    const plain = log ? 10 ** value : value;
    const size = Math.abs(plain);
    return size !== 0 && (size < 1e-3 || size >= 1e5) ? plain.toExponential(2) : String(Number(plain.toPrecision(5)));
  };

  const ticks = (low, high, log, wanted) => {
    if (log && high - low > 0.8) {
      const out = [];
      const dense = high - low < 2.2 && wanted > 3 ? [1, 2, 5] : [1];
      const every = Math.ceil((high - low) / (wanted + 1));
      for (let decade = Math.floor(low); decade <= high; decade += every)
        for (const digit of dense) out.push([decade + Math.log10(digit), digit * 10 ** decade]);
      return out.filter(([at]) => at >= low && at <= high);
    }
    const [least, most] = log ? [10 ** low, 10 ** high] : [low, high];
    const rough = (most - least) / wanted;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= rough);
    const out = [];
    for (let k = Math.ceil(least / step); k * step <= most; k += 1) out.push([log ? Math.log10(k * step) : k * step, k * step]);
    return out;
  };

  class Drawing {
    constructor(place, figure) {
      this.place = place;
      this.figure = figure;
      this.curves = figure.curves.map((curve) => ({ ...curve, at: points(curve, figure.span) }));
      this.shown = figure.span;
      this.readout = place.parentElement.querySelector(".readout");
      place.addEventListener("pointermove", (event) => this.point(event));
      place.addEventListener("pointerleave", () => this.leave());
      place.addEventListener("dblclick", () => this.zoom(figure.span));
      if (matchMedia("(pointer: fine)").matches) {
        place.addEventListener("pointerdown", (event) => { this.from = this.inside(event); });
        place.addEventListener("pointerup", (event) => this.drop(this.inside(event)));
      }
    }

    zoom(shown) {
      this.shown = shown;
      this.draw();
    }

    view() { // one unit as long in both directions where that is wanted
      const [x, y] = this.shown.map((span) => [...span]);
      if (!this.figure.equal) return [x, y];
      const unit = Math.max((x[1] - x[0]) / this.size[0], (y[1] - y[0]) / this.size[1]);
      return [x, y].map((span, k) => {
        const extra = (unit * this.size[k] - (span[1] - span[0])) / 2;
        return [span[0] - extra, span[1] + extra];
      });
    }

    draw() {
      const width = Math.max(this.place.clientWidth, 240);
      const height = Math.max(this.place.clientHeight, 160);
      this.size = [width - PAD.left - PAD.right, height - PAD.top - PAD.bottom];
      const [x, y] = (this.seen = this.view());
      this.x = (value) => PAD.left + ((value - x[0]) / (x[1] - x[0])) * this.size[0];
      this.y = (value) => PAD.top + (1 - (value - y[0]) / (y[1] - y[0])) * this.size[1];
      const svg = document.createElementNS(NAME, "svg");
      svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      const clip = `${this.place.id}-clip`;
      const frame = { x: PAD.left, y: PAD.top, width: this.size[0], height: this.size[1] };
      element("rect", frame, element("clipPath", { id: clip }, svg));
      const [log_x, log_y] = this.figure.log;
      for (const [at, value] of ticks(...x, log_x, Math.max(3, Math.floor(width / 90)))) {
        element("line", { class: "grid", x1: this.x(at), x2: this.x(at), y1: PAD.top, y2: PAD.top + this.size[1] }, svg);
        const text = element("text", { x: this.x(at), y: height - 8, "text-anchor": "middle" }, svg);
        text.textContent = told(value, false);
      }
      for (const [at, value] of ticks(...y, log_y, Math.max(4, Math.floor(height / 45)))) {
        element("line", { class: "grid", x1: PAD.left, x2: width - PAD.right, y1: this.y(at), y2: this.y(at) }, svg);
        const text = element("text", { x: PAD.left - 6, y: this.y(at) + 4, "text-anchor": "end" }, svg);
        text.textContent = told(value, false);
      }
      element("rect", { ...frame, class: "frame" }, svg);
      const inner = element("g", { "clip-path": `url(#${clip})` }, svg);
      for (const curve of this.curves) this.curve(curve, inner);
      this.mark = element("circle", { class: "pointed", r: 4, visibility: "hidden" }, svg);
      this.box = element("rect", { class: "box", visibility: "hidden" }, svg);
      this.place.replaceChildren(svg);
    }

    curve(curve, parent) {
      const group = element("g", { class: curve.class + (curve.faint ? " faint" : "") }, parent);
      if (curve.marks) {
        curve.at.forEach((at, k) => {
          if (at === null) return;
          element("circle", { cx: this.x(at[0]), cy: this.y(at[1]), r: 3.5 }, group);
          if (!curve.texts) return;
          const text = element("text", { x: this.x(at[0]) + 6, y: this.y(at[1]) - 5 }, group);
          text.textContent = curve.texts[k];
        });
        return;
      }
      let path = "";
      let pen = "M";
      for (const at of curve.at) {
        if (at) path += `${pen}${this.x(at[0]).toFixed(1)} ${this.y(at[1]).toFixed(1)}`;
        pen = at ? "L" : "M";
      }
      if (path) element("path", { d: path, "stroke-dasharray": curve.dash || "none" }, group);
    }

    inside(event) {
      const frame = this.place.getBoundingClientRect();
      return [event.clientX - frame.left, event.clientY - frame.top];
    }

    point(event) {
      const [px, py] = this.inside(event);
      if (this.from && event.buttons === 1) return this.stretch(px, py);
      let best = null;
      for (const curve of this.curves)
        for (const at of curve.at) {
          if (!at) continue;
          const far = Math.hypot(this.x(at[0]) - px, this.y(at[1]) - py);
          if (far < (best ? best.far : 40)) best = { far, at, curve };
        }
      if (!best) return this.leave();
      const [log_x, log_y] = this.figure.log;
      const name = best.curve.name ? `${best.curve.name}: ` : "";
      this.readout.textContent = `${name}${told(best.at[0], log_x)}, ${told(best.at[1], log_y)}`;
      this.mark.setAttribute("cx", this.x(best.at[0]));
      this.mark.setAttribute("cy", this.y(best.at[1]));
      this.mark.setAttribute("visibility", "visible");
    }

    leave() {
      this.readout.textContent = "";
      this.mark.setAttribute("visibility", "hidden");
    }

    stretch(px, py) {
      const [fx, fy] = this.from;
      const box = { x: Math.min(px, fx), y: Math.min(py, fy), width: Math.abs(px - fx), height: Math.abs(py - fy) };
      for (const [key, value] of Object.entries(box)) this.box.setAttribute(key, value);
      this.box.setAttribute("visibility", "visible");
    }

    drop(to) {
      const from = this.from;
      this.from = null;
      if (!from || Math.abs(to[0] - from[0]) < 8 || Math.abs(to[1] - from[1]) < 8) return this.draw();
      const [x, y] = this.seen;
      const at = (pixel) => [
        x[0] + ((pixel[0] - PAD.left) / this.size[0]) * (x[1] - x[0]),
        y[0] + (1 - (pixel[1] - PAD.top) / this.size[1]) * (y[1] - y[0]),
      ];
      const [a, b] = [at(from), at(to)];
      this.zoom([0, 1].map((k) => [Math.min(a[k], b[k]), Math.max(a[k], b[k])]));
    }
  }

  // drawn again where its width changes
  const drawings = new Map();
  const changed = new ResizeObserver((entries) => {
    for (const entry of entries) drawings.get(entry.target).draw();
  });
  for (const data of document.querySelectorAll("script[data-plot]")) {
    const place = document.getElementById(data.dataset.plot);
    drawings.set(place, new Drawing(place, JSON.parse(data.textContent)));
    drawings.get(place).draw();
    changed.observe(place);
  }
  document.body.dataset.drawn = "all";
})();
