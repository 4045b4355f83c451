// Moves of an axis that is held: asked for, followed as long as this page is there, and what the axis answered.
import { Connection, post } from "./connection.js";
import { parsed, traced } from "./frames.js";
import { by, cell, head, isMeant, notice, offer, rows, short, showStatus, themeButton } from "./page.js";
import { Panels } from "./panels.js";

const LABELS = {
  setpoint_um: "set-point", strain_um: "strain gauge", reference_um: "reference", stage_um: "stage", voltage_V: "voltage",
};
const LOOK_MS = 250;
const LIVE_S = 5;
const LEAD_S = 0.05;
const SETTLES_S = 0.3;
const FIGURES = {
  error_rms_um: ["set-point less position, rms", "µm"], error_peak_um: ["set-point less position, peak", "µm"],
  overshoot_percent: ["overshoot", "%"], rise_s: ["rise, 10 to 90 %", "s"], settling_s: ["settled to 2 % after", "s"],
  gain: ["gain", ""], lag_deg: ["lag", "°"],
};
const NUMBERS = {
  step: ["by_um", "way_s", "rest_s"], sine: ["amplitude_um", "frequency_Hz", "seconds"],
  sweep: ["amplitude_um", "frequency_Hz", "to_Hz", "seconds"], waypoints: ["way_s", "rest_s"],
};

let controller = null, state = "", operates = false;
let running = false, stopping = false;
let view = { last: null, span_s: LIVE_S, begun: null };

const form = by("move").elements;
const panels = new Panels(by("plots"), { whole: live }, true);
const fields = () => Object.keys(LABELS).map((name, i) => {
  const found = controller.fields.find((field) => field.name === `${form.axis.value}.${name}`);
  const isOfStage = ["reference_um", "stage_um"].includes(name);
  return { ...found, label: LABELS[name], unit: isOfStage ? "µm, stage" : found.unit, colour: `--trace-${(i % 2) + 1}` };
});
const period = () => controller.period_ns * 1e-9;

function askView() {
  if (!controller) return;
  connection.send({ type: "view", fields: fields().map(({ name }) => name), span_s: view.span_s, points: panels.points, last: view.last });
}

function live() {
  view = { last: null, span_s: LIVE_S, begun: null };
  askView();
}

function draw(header, arrays) {
  if (view.last !== null && header.last !== view.last) return;
  const zero = view.begun ?? header.last, step = period();
  const { times, traces } = traced(header, arrays, zero, step);
  const known = fields().filter(({ name }) => traces[name][0].some(Number.isFinite));
  panels.arrange(known);
  panels.draw([(header.first - zero) * step, (header.last - zero) * step], times, traces, [], [], view.begun === null ? null : 0);
}

function arrange() {
  offer(by("move"), running);
  for (const name of ["axis", "kind"]) form[name].disabled = running;
  const why = !operates ? "This token only observes: moving takes one whose scope is operate." : state !== "HOLDING" ? `An axis is moved while HOLDING; the state is ${state || "unknown"}.` : "";
  by("begin").disabled = running || why !== "" || !controller;
  by("stop").disabled = !running;
  if (!running && (why || /^(This token|An axis is moved)/.test(by("said").textContent))) by("said").textContent = why;
}

function asked() {
  const kind = form.kind.value, wanted = { axis: form.axis.value, kind };
  for (const name of NUMBERS[kind]) wanted[name] = form[name].valueAsNumber;
  if (kind === "waypoints") wanted.places_um = form.places_um.value.split(",").map(Number);
  if (["step", "waypoints"].includes(kind)) wanted.returns = form.returns.checked;
  return wanted;
}

function said({ axis, kind, ...wanted }) {
  const what = {
    step: () => `by ${short(wanted.by_um)} µm in ${wanted.way_s} s${wanted.returns ? ", and back" : ", and stays there"}`,
    sine: () => `±${short(wanted.amplitude_um)} µm at ${wanted.frequency_Hz} Hz for ${wanted.seconds} s`,
    sweep: () => `±${short(wanted.amplitude_um)} µm from ${wanted.frequency_Hz} to ${wanted.to_Hz} Hz in ${wanted.seconds} s`,
    waypoints: () => `to ${wanted.places_um.join(", ")} µm from where it is${wanted.returns ? ", and back" : ", and stays there"}`,
  }[kind]();
  return `Axis ${axis} moves ${what}. Nobody's hand is near the spindle?`;
}

const ask = async (path, document) => (await post(path, document)).json();

async function move() {
  const wanted = asked();
  if (running || by("begin").disabled || !(await isMeant(`Move axis ${wanted.axis}?`, said(wanted))) || by("begin").disabled) return;
  running = true;
  stopping = false;
  arrange();
  live();
  by("figures").replaceChildren();
  by("what").textContent = `axis ${wanted.axis}, ${wanted.kind}`;
  by("said").textContent = "moving";
  let begun = null;
  try {
    let at = await ask("/api/move", wanted);
    const { number } = at;
    while (!at.done) {
      begun = at.begun_cycle ?? begun;
      by("progress").value = at.progress;
      await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
      at = await ask("/api/move", stopping ? { number, stop: true } : { number });
    }
    begun = at.begun_cycle;
    by("said").textContent = "done: the axis is held where it began";
    if (wanted.returns === false) by("said").textContent = `done: the axis is held ${short(at.offset_um)} µm from where it began`;
    await new Promise((resolve) => setTimeout(resolve, 1000 * SETTLES_S));
    await showResponse(wanted, begun, at.seconds);
  } catch (problem) {
    by("said").textContent = problem.message;
  }
  running = false;
  by("progress").value = 0;
  arrange();
}

/** Exactly the move, and what is read off it; of a step the way there. */
async function showResponse(wanted, begun, length_s) {
  const cycles = (s) => Math.round(s / period());
  view = { begun, last: begun + cycles(length_s + SETTLES_S - LEAD_S), span_s: length_s + SETTLES_S };
  askView();
  const isStep = wanted.kind === "step", last = begun + cycles(isStep ? wanted.way_s + wanted.rest_s : length_s) - 1;
  const more = isStep ? { by_um: wanted.by_um } : wanted.kind === "sine" ? { frequency_Hz: wanted.frequency_Hz } : {};
  const { wanted: from, found, figures } = await ask("/api/response", { axis: wanted.axis, first: begun, last, ...more });
  rows(by("figures"), [
    [head(`${from} and ${found}`), head("", "number"), head("")],
    ...Object.entries(figures).map(([name, value]) => [cell(FIGURES[name][0]), cell(short(value), "number"), cell(FIGURES[name][1])]),
  ]);
}

function stop() {
  if (!running || stopping) return;
  stopping = true;
  by("said").textContent = "stopping";
}

const connection = new Connection((message) => {
  if (message instanceof ArrayBuffer) {
    const [header, arrays] = parsed(message);
    if (header.type === "frame") draw(header, arrays);
  } else if (message.type === "hello") {
    operates = message.scope === "operate";
    controller = message.cell;
    if (controller) {
      const kept = form.axis.value;
      form.axis.replaceChildren(...controller.axes.map((name) => new Option(name)));
      if (controller.axes.includes(kept)) form.axis.value = kept;
      live();
    }
    arrange();
    return;
  } else if (message.type === "status") {
    state = message.status?.state ?? "";
    showStatus(message);
    arrange();
  } else if (message.type === "problem") notice(message.problem, true);
  connection.drawn();
}, (why) => {
  stop();
  notice(why, true);
});

by("stop").addEventListener("click", stop);
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !by("question").open) stop();
});
document.addEventListener("visibilitychange", () => {
  if (document.hidden) stop();
});
by("move").addEventListener("submit", (event) => {
  event.preventDefault();
  move();
});
form.kind.addEventListener("change", arrange);
form.axis.addEventListener("change", live);
themeButton(() => panels.redraw());
arrange();
