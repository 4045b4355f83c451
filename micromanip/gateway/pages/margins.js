// Margins of a running loop: measured by the controller, asked for as long as this page is there, drawn as they come.
import { post } from "./connection.js";
import { SensitivityPlot } from "./curves.js";
import { traced } from "./frames.js";
import { by, cell as td, figure, head, isMeant, rows, themeButton } from "./page.js";
import { Panels } from "./panels.js";
import { Supervised } from "./supervised.js";

const DRAWS = 2;
const LOOK_MS = 250;
const LIVE_S = 1;

let running = false;

const form = by("measure").elements;
const plot = new SensitivityPlot(by("curve"));
const panels = new Panels(by("live"), { zoomed: () => {}, wheel: () => {}, whole: () => {}, pointed: () => {} });
const SHOWN = { strain: ["setpoint_um", "strain_um", "voltage_V"], stage: ["reference_um", "stage_um", "voltage_V"] };
const fields = () => SHOWN[form.loop.value].map((name, i) => [name, i + 1]).map(([name, colour]) => {
  const found = cell.controller.fields.find((field) => field.name === `${form.axis.value}.${name}`);
  return { ...found, colour: `--trace-${colour}` };
});

function askLive() {
  if (!cell.controller) return;
  cell.connection.send({ type: "view", fields: fields().map(({ name }) => name), span_s: LIVE_S, points: panels.points, last: null });
}

function drawLive(header, arrays) {
  const { times, traces } = traced(header, arrays, header.last, cell.controller.period_ns * 1e-9);
  panels.arrange(fields());
  panels.draw([-LIVE_S, 0], times, traces, [], [], null);
}

function arrange() {
  const fits = ["TRACKING", "HOLDING"].includes(cell.state);
  by("begin").disabled = running || !cell.operates || !fits || !cell.controller;
  by("stop").disabled = !running;
  for (const name of ["axis", "loop", "amplitude_um", "seed"]) form[name].disabled = running;
  if (running) return;
  if (!cell.operates) by("said").textContent = "This token only observes: measuring takes one whose scope is operate.";
  else if (!fits) by("said").textContent = cell.state ? `A loop is measured while TRACKING or HOLDING; the state is ${cell.state}.` : "";
  else if (by("said").textContent.startsWith("A loop is measured") || by("said").textContent.startsWith("This token")) by("said").textContent = "";
}

const question = (wanted) => `It moves: ${wanted.amplitude_um} µm rms on its set-point, ${DRAWS} times for 5 s, while ${cell.state}.`;
const ask = async (wanted) => (await post("/api/sensitivity", wanted)).json();

async function measure() {
  const wanted = { axis: form.axis.value, loop: form.loop.value, amplitude_um: form.amplitude_um.valueAsNumber };
  const seed = form.seed.valueAsNumber;
  if (running || by("begin").disabled || !(await isMeant(`Measure axis ${wanted.axis}?`, question(wanted)))) return;
  running = true;
  arrange();
  plot.clear();
  by("margins").replaceChildren();
  by("verdict").textContent = "";
  by("what").textContent = `axis ${wanted.axis}, ${wanted.loop} loop`;
  try {
    const done = [];
    for (let draw = 0; draw < DRAWS && running; draw++) {
      const begun = await ask({ ...wanted, seed: seed + draw });
      by("said").textContent = `measuring, ${draw + 1} of ${DRAWS}`;
      const answer = await followed(begun.number, done, draw);
      if (!answer) break;
      done.push(begun.number);
      show(answer, draw + 1 === DRAWS);
    }
    by("said").textContent = running ? "measured" : "stopped: it fades out";
  } catch (problem) {
    by("said").textContent = problem.message;
  }
  running = false;
  by("progress").value = 0;
  arrange();
}

/** Where the measurement stands, again and again; its end, or null where it was stopped. */
async function followed(number, done, draw) {
  while (running) {
    const answer = await ask({ number, with: done });
    by("progress").value = (draw + answer.progress) / DRAWS;
    if (answer.done) return answer;
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
  }
  return null;
}

function show({ found, problem }, isLast) {
  if (!found) {
    by("verdict").textContent = problem;
    return;
  }
  plot.draw(found);
  const line = (said, slope, margins) => [td(said), td(figure(slope), "number"), td(figure(margins.Ms), "number"), td(figure(margins.at_Hz, 0), "number"), td(figure(margins.gain_dB, 1), "number"), td(figure(margins.phase_deg, 0), "number")];
  rows(by("margins"), [
    [head(""), head("slope", "number"), head("Ms", "number"), head("at, Hz", "number"), head("gain, dB", "number"), head("phase, °", "number")],
    ...found.slopes.flatMap(({ slope, measured, predicted }) => [line("measured", slope, measured), ...(predicted ? [line("predicted", slope, predicted)] : [])]),
  ]);
  const sure = `Ms ${figure(found.Ms_least)} to ${figure(found.Ms_most)} by its confidence`;
  const agrees = found.agrees === null ? "no model of the actuator to predict it by" : found.agrees ? "measured and predicted agree" : "";
  by("verdict").textContent = [isLast ? "" : "first half", sure, found.problem ?? agrees].filter(Boolean).join("; ");
  by("verdict").classList.toggle("bad", Boolean(found.problem) && isLast);
}

function stop() {
  if (!running) return;
  running = false;
  by("said").textContent = "stopped: it fades out within a second";
}

const cell = new Supervised({ axis: form.axis, draw: drawLive, look: askLive, arrange, stop });

by("measure").addEventListener("submit", (event) => {
  event.preventDefault();
  measure();
});
for (const name of ["axis", "loop"]) form[name].addEventListener("change", askLive);
themeButton(() => {
  panels.redraw();
  plot.redraw();
});
arrange();
