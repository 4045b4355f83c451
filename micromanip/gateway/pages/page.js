// What the pages share: building elements, the status, questions, the theme's button, figures as text.

export const by = (id) => document.getElementById(id);

/** A new element with properties and children; text is only ever text. */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "data") Object.assign(made.dataset, value);
    else made[name] = value;
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** The line below the header; hidden where there is nothing to say. */
export function notice(text, bad = false) {
  by("notice").textContent = text;
  by("notice").hidden = !text;
  by("notice").classList.toggle("bad", bad);
}

export function themeButton(changed = () => {}) {
  by("theme").addEventListener("click", () => {
    localStorage.setItem("theme", document.documentElement.dataset.theme === "dark" ? "light" : "dark");
    document.documentElement.dataset.theme = localStorage.getItem("theme");
    changed();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => changed());
}

export function swatch({ colour }) {
  const found = element("span", { className: "swatch" });
  found.style.background = `var(${colour})`;
  return found;
}

/** State, configuration, and what is wrong, of a status message. */
export function showStatus({ status, problem, differs, unseen }) {
  by("state").textContent = status?.state ?? "NO CONTROLLER";
  by("where").textContent = status?.configuration ?? "";
  const fault = (unseen ?? status)?.fault_reports.at(-1);
  const bad = [problem, fault ? `${fault.seen}. ${fault.next_step}` : null].filter(Boolean);
  notice(bad.join("\n") || (differs ?? ""), bad.length > 0);
}

/** Whether the person says yes; enter means `usual`. */
export async function isMeant(title, text, usual = "no") {
  const dialog = by("question");
  dialog.querySelector("h1").textContent = title;
  dialog.querySelector("p").textContent = text;
  dialog.returnValue = "no";
  dialog.showModal();
  dialog.querySelector(`[value="${usual}"]`).focus();
  await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
  return dialog.returnValue === "yes";
}

/** Of a form, what goes with the kind that is chosen; what is hidden, or all of it where it `isBusy`, takes nothing. */
export function offer(form, isBusy = false) {
  for (const label of form.querySelectorAll("[data-for]")) {
    label.hidden = !label.dataset.for.split(" ").includes(form.elements.kind.value);
    for (const input of label.children) input.disabled = label.hidden || isBusy;
  }
}

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** A number of fixed digits behind the point, with a real minus; a dash where there is none. */
export function figure(value, digits = 2) {
  return value === null || value === undefined || Number.isNaN(value) ? "–" : value.toFixed(digits).replace("-", "−");
}

/** A whole number in groups of three digits. */
export const count = (number) => String(number).replace(/\B(?=(\d{3})+$)/g, "\u202f");

/** A number with four significant digits. */
export function short(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e6 || size < 1e-3 ? value.toExponential(3) : size >= 1000 ? value.toFixed(0) : value.toPrecision(4);
  return text.replaceAll("-", "−");
}

/** Seconds with the unit that fits. */
export function seconds(value, digits = 3) {
  const size = Math.abs(value);
  const [unit, scale] = size >= 1 || size === 0 ? ["s", 1] : size >= 1e-3 ? ["ms", 1e3] : ["µs", 1e6];
  if (size >= 120) return `${figure(value / 60, 1)} min`;
  return `${Number((value * scale).toPrecision(digits)).toString().replace("-", "−")} ${unit}`;
}

/** Labels of times (s) beside each other, with as many digits as their distance asks for; from two minutes on as a clock. */
export function timeTicks(ticks) {
  const size = Math.max(...ticks.map(Math.abs)), step = ticks.length > 1 ? ticks[1] - ticks[0] : size;
  const decimals = (scale) => Math.min(9, Math.max(0, Math.ceil(-Math.log10(step * scale) - 1e-9)));
  if (size >= 120) return ticks.map((tick) => clock(tick, decimals(1)));
  const [unit, scale] = size >= 1 || size === 0 ? ["s", 1] : size >= 1e-3 ? ["ms", 1e3] : ["µs", 1e6];
  return ticks.map((tick) => `${Number((tick * scale).toFixed(decimals(scale))).toString().replace("-", "−")} ${unit}`);
}

/** A moment (s) to the cycle. */
export const moment = (time) => (Math.abs(time) >= 120 ? clock(time, 5) : seconds(time, 7));

function clock(value, decimals) {
  const all = Number(Math.abs(value).toFixed(decimals)), minutes = Math.floor(all / 60);
  const two = (number, digits = 0) => number.toFixed(digits).padStart(digits ? digits + 3 : 2, "0");
  const parts = minutes >= 60 ? [Math.floor(minutes / 60), two(minutes % 60)] : [minutes];
  return `${value < 0 ? "−" : ""}${[...parts, two(all - 60 * minutes, decimals)].join(":")}`;
}

export const unitText = (unit) => (unit === "um" ? "µm" : unit);

/** An axis of a plot, as uPlot has it. */
export function plotAxis() {
  const font = "13px system-ui, sans-serif", grid = () => colour("--grid");
  return { stroke: () => colour("--faint"), grid: { stroke: grid, width: 1 }, ticks: { stroke: grid }, font, labelFont: font, labelSize: 18 };
}

export const plainTicks = (plot, ticks) => ticks.map((tick) => String(Number(tick.toPrecision(10))).replace("-", "−"));

/** Ends of an axis for values from `low` to `high`, null where there are none. */
export function padded(low, high) {
  if (low === null || high === null) return [0, 1];
  const edge = (high - low) * 0.06 || Math.abs(high) * 0.01 || 0.5;
  return [low - edge, high + edge];
}

export function rows(table, lines) {
  table.replaceChildren(...lines.map((line) => element("tr", {}, ...line)));
}

export const cell = (text, name = "") => element("td", { className: name }, text);
export const head = (text, name = "") => element("th", { className: name }, text);
