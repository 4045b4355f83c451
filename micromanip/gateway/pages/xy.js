// One field over another, such as a hysteresis loop: drawn on a canvas, as time runs neither left nor right.
import { colour, element, short, unitText } from "./page.js";

const [LEFT, BOTTOM, TOP, RIGHT] = [86, 52, 14, 18];

export class XyView {
  constructor(place) {
    this.place = place;
    this.last = null;
  }

  clear() {
    this.place.replaceChildren();
    this.canvas = null;
  }

  draw(x, y, xField, yField) {
    this.last = [x, y, xField, yField];
    if (!this.canvas) {
      this.clear();
      this.canvas = element("canvas", { className: "xy" });
      this.place.append(this.canvas);
    }
    const [width, height] = [this.place.clientWidth - 12, Math.max(280, Math.min(720, window.innerHeight - 310))];
    const canvas = this.canvas;
    canvas.width = width * devicePixelRatio;
    canvas.height = height * devicePixelRatio;
    canvas.style.height = `${height}px`;
    const ctx = canvas.getContext("2d");
    ctx.scale(devicePixelRatio, devicePixelRatio);
    const xs = ticks(x, (width - LEFT - RIGHT) / 90), ys = ticks(y, (height - TOP - BOTTOM) / 50);
    const px = (value) => LEFT + ((value - xs.low) / (xs.high - xs.low)) * (width - LEFT - RIGHT);
    const py = (value) => height - BOTTOM - ((value - ys.low) / (ys.high - ys.low)) * (height - TOP - BOTTOM);
    ctx.font = "13px system-ui, sans-serif";
    ctx.strokeStyle = colour("--grid");
    ctx.fillStyle = colour("--faint");
    ctx.textAlign = "center";
    for (const tick of xs.at) {
      line(ctx, px(tick), TOP, px(tick), height - BOTTOM);
      ctx.fillText(short(tick), px(tick), height - BOTTOM + 18);
    }
    ctx.textAlign = "right";
    for (const tick of ys.at) {
      line(ctx, LEFT, py(tick), width - RIGHT, py(tick));
      ctx.fillText(short(tick), LEFT - 8, py(tick) + 4);
    }
    ctx.textAlign = "center";
    ctx.fillText(named(xField), (LEFT + width) / 2, height - 10);
    ctx.save();
    ctx.translate(16, height / 2);
    ctx.rotate(-Math.PI / 2);
    ctx.fillText(named(yField), 0, 0);
    ctx.restore();
    ctx.strokeStyle = colour("--trace-1");
    ctx.lineWidth = 1.25;
    ctx.beginPath();
    let drawing = false;
    for (let i = 0; i < x.length; i++) {
      const known = Number.isFinite(x[i]) && Number.isFinite(y[i]);
      if (known && drawing) ctx.lineTo(px(x[i]), py(y[i]));
      else if (known) ctx.moveTo(px(x[i]), py(y[i]));
      drawing = known;
    }
    ctx.stroke();
  }

  resize() {
    if (this.canvas && this.last) this.draw(...this.last);
  }
}

const named = (field) => (field.unit ? `${field.name}, ${unitText(field.unit)}` : field.name);

function line(ctx, x0, y0, x1, y1) {
  ctx.beginPath();
  ctx.moveTo(x0, y0);
  ctx.lineTo(x1, y1);
  ctx.stroke();
}

/** Round places for about `count` ticks that hold all values, and the ends of the axis. */
function ticks(values, count) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (!(low <= high)) [low, high] = [0, 1];
  if (low === high) [low, high] = [low - 0.5, high + 0.5];
  const raw = (high - low) / Math.max(2, count), size = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((factor) => factor * size >= raw) * size;
  const begin = Math.floor(low / step) * step, at = [];
  for (let i = 0; begin + i * step < high + step; i++) at.push(begin + i * step);
  return { low: begin, high: at.at(-1), at };
}
