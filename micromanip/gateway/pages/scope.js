// The scope: what is shown, and who is asked for it. Time is counted in cycles; s are made only to be shown.
import { Connection, post } from "./connection.js";
import { SpectrumView, XyView } from "./curves.js";
import { parsed, traced } from "./frames.js";
import { by, count, element, moment, notice, seconds, showStatus, themeButton, unitText } from "./page.js";
import { Panels, readout } from "./panels.js";
import { TriggerForm } from "./trigger.js";

const SPANS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60, 120, 300, 600, 1800, 3600];
const COLOURS = 8;
const LOOK_MS = 500;
const READOUT_MS = 200;
const GROWS_MS = 700;
const CURSOR_STEPS = 200;

let controller = null;
let chosen = JSON.parse(localStorage.getItem("fields") ?? "null");
let tab = "time";
let view = { span_s: 1, last: null };
let reference = null;
let frame = null;
let growing = null;
let newest = "A";
let isLive = true;
let askedMs = 0, readMs = 0;
window.scopeFrames = [];

const panels = new Panels(by("plots"), {
  zoomed: (from, to) => look(reference + Math.round(to / period()), to - from),
  wheel: (at, factor) => zoom(factor, at),
  whole: () => follow(),
  pointed: () => showReadout(),
});
const spectrum = new SpectrumView(by("plots"));
const xy = new XyView(by("plots"));
const trigger = new TriggerForm(by("trigger"), () => {
  view.last = null;
  showArmed();
  askView();
});

const longest = () => (controller.recording ? Math.max(1, wholeSpan()) : 3600);
const wholeSpan = () => Math.max(0.001, (controller.recording.last - controller.recording.first) * period());
const period = () => controller.period_ns * 1e-9;
const known = () => (chosen ?? []).filter((name) => controller.fields.some((field) => field.name === name));
const fields = () => known().map((name, i) => ({ ...controller.fields.find((field) => field.name === name), colour: `--trace-${(i % COLOURS) + 1}` }));

function askView() {
  if (!controller) return;
  localStorage.setItem("fields", JSON.stringify(chosen));
  connection.send({ type: "view", fields: known(), span_s: view.span_s, points: panels.points, last: view.last });
  connection.send({ type: "trigger", trigger: view.last === null ? trigger.query : null });
  by("freeze").setAttribute("aria-pressed", String(view.last !== null));
  by("freeze").textContent = view.last === null ? "Freeze" : "Live";
  const value = SPANS.find((span) => Math.abs(span / view.span_s - 1) < 1e-6);
  by("span").querySelector("[data-other]")?.remove();
  if (value === undefined) by("span").prepend(element("option", { value: "other", data: { other: "1" } }, seconds(view.span_s)));
  by("span").value = value === undefined ? "other" : String(value);
  if (tab === "time") panels.arrange(fields());
}

/** Show `span_s` up to the cycle `last`, frozen. */
function look(last, span_s) {
  view = { span_s: Math.min(longest(), Math.max(0.001, span_s)), last: Math.max(1, last) };
  askView();
}

/** The newest, or all of a recording. */
function follow() {
  if (controller.recording) {
    look(controller.recording.last, wholeSpan());
    return;
  }
  view.last = null;
  if (frame && view.span_s < 0.001) view.span_s = 1;
  askView();
}

/** Around the time `at` (s), None: the middle; a live scope only changes its length. */
function zoom(factor, at = null) {
  const span = Math.min(longest(), Math.max(0.001, view.span_s * factor));
  if (view.last === null) {
    view.span_s = SPANS.reduce((best, each) => (Math.abs(Math.log(each / span)) < Math.abs(Math.log(best / span)) ? each : best));
    askView();
    return;
  }
  const end = (view.last - reference) * period(), middle = at ?? end - view.span_s / 2;
  look(reference + Math.round((middle + (end - middle) * (span / view.span_s)) / period()), span);
}

function move(share) {
  if (!frame) return;
  look((view.last ?? frame.header.last) + Math.round((share * view.span_s) / period()), view.span_s);
}

function freeze() {
  if (view.last === null && frame) look(frame.header.last, view.span_s);
  else follow();
}

function show(header, arrays) {
  if (controller.recording) reference = controller.recording.first;
  else if (view.last === null) reference = header.trigger_cycle ?? header.last;
  else if (header.trigger_cycle === null && header.last !== view.last) return;
  reference ??= header.last;
  if (controller.recording) grow(header);
  const shown = [(header.first - reference) * period(), (header.last - reference) * period()];
  frame = { header, ...traced(header, arrays, reference, period()), shown };
  if (tab === "time") draw();
  window.scopeFrames.push(header);
  if (window.scopeFrames.length > 50) window.scopeFrames.shift();
  summarise(header);
  const now = performance.now();
  if (tab !== "time" && now - askedMs > LOOK_MS) {
    askedMs = now;
    askMore();
  }
  if (now - readMs > READOUT_MS) showReadout();
}

/** Its overview is made meanwhile: faults are found, and more of what is seen is there to be asked for. */
function grow({ known, marks }) {
  const recording = controller.recording;
  if (marks.length !== recording.marks.length) {
    recording.marks = marks;
    offerMarks(marks);
    noticeRecording(recording);
  }
  recording.known = known;
  clearTimeout(growing);
  if (known < 1) growing = setTimeout(askView, GROWS_MS);
}

function draw() {
  const { header, times, traces, shown } = frame;
  panels.arrange(fields());
  const volts = fields().filter((field) => field.unit === "V").map((field) => field.name.split(".")[0]);
  const limits = [...new Set(volts.flatMap((axis) => controller.range_V[axis] ?? []))];
  const at = header.trigger_cycle === null ? null : (header.trigger_cycle - reference) * period();
  panels.marks = (controller.recording?.marks ?? []).map(([cycle, kind, text]) => [(cycle - reference) * period(), kind, text]);
  panels.draw(shown, times, traces, bands(times, traces.state, shown[1]), limits, at);
}

/** Where the cell was in which state. */
function bands(times, [low, high], end) {
  const found = [], states = high ?? low;
  for (let i = 0; i < times.length; i++) {
    const name = controller.states[states[i]];
    if (found.length && found.at(-1)[2] === name) continue;
    if (found.length) found.at(-1)[1] = times[i];
    found.push([times[i], end, name]);
  }
  return found;
}

function summarise(header) {
  const part = (name, value, bad = false) => element("span", { className: bad ? "bad" : "" }, `${name} `, element("b", {}, value));
  by("summary").replaceChildren(
    controller.recording ? part("from the first cycle,", `${moment((header.first - reference) * period())} to ${moment((header.last - reference) * period())}`) : part(view.last !== null ? "frozen, up to cycle" : header.trigger_cycle !== null ? "triggered at cycle" : isLive ? "live, up to cycle" : "no controller, up to cycle", count(header.trigger_cycle ?? header.last)),
    part("a point is", header.rows === 1 ? "1 cycle" : `least and greatest of ${count(header.rows)} cycles`),
    part(controller.recording ? "not in the file" : "skipped by the loop", `${count(header.missing)} cycles`),
    part("lost", String(header.lost), header.lost > 0),
    ...(header.known < 1 ? [part("overview so far", `${(header.known * 100).toFixed(0)} %`)] : []),
    part(controller.recording ? "recorded" : "history", seconds((header.newest - header.oldest) * period())),
  );
  showArmed(header.trigger_cycle !== null && trigger.mode === "single");
}

function showArmed(stopped = false) {
  by("armed").textContent = stopped ? "stopped" : { off: "", auto: "auto", normal: "waits", single: "waits" }[trigger.mode];
}

function askMore() {
  if (!frame) return;
  const { first, last } = frame.header;
  if (tab === "spectrum" && known().length) connection.send({ type: "spectrum", fields: known(), first, last });
  if (tab === "xy" && by("x").value) connection.send({ type: "xy", fields: [by("x").value, by("y").value], first, last });
}

function showMore(header, arrays) {
  if (header.type === "spectrum" && tab === "spectrum") {
    spectrum.draw(arrays, fields());
    spectrum.list(by("readout"), header, fields());
    by("summary").replaceChildren(element("span", {}, `Welch, Hann, ${header.averages} averages over ${seconds(header.seconds)}; lines by a flat-top window; ${(header.missing * 100).toPrecision(2)} % of the cycles interpolated`));
  } else if (header.type === "xy" && tab === "xy") {
    const of = (name) => controller.fields.find((field) => field.name === name);
    xy.draw(arrays.x, arrays.y, of(header.fields[0]), of(header.fields[1]));
  }
}

function showReadout() {
  if (!frame || tab !== "time") return;
  readMs = performance.now();
  readout(by("readout"), fields(), frame.times, frame.traces, panels.pointer, panels.cursors);
}

function choose(name) {
  tab = name;
  for (const button of document.querySelectorAll("[data-tab]")) button.setAttribute("aria-pressed", String(button.dataset.tab === name));
  by("axes-xy").hidden = name !== "xy";
  for (const each of [panels, spectrum, xy]) each.clear();
  by("readout").replaceChildren();
  askedMs = 0;
  if (name === "time" && frame) draw();
  askMore();
}

function offer() {
  const groups = new Map();
  for (const field of controller.fields) {
    const [axis, name] = field.name.includes(".") ? field.name.split(".") : ["", field.name];
    groups.set(axis, [...(groups.get(axis) ?? []), { ...field, shown: name }]);
  }
  by("fields").replaceChildren(...[...groups].map(([axis, own]) => element("details", { open: axis === controller.axes[0] },
    element("summary", {}, axis ? `axis ${axis}` : "cell"),
    ...own.map((field) => {
      const box = element("input", { type: "checkbox", checked: known().includes(field.name), value: field.name });
      box.addEventListener("change", () => {
        chosen = box.checked ? [...known(), field.name] : known().filter((name) => name !== field.name);
        askView();
        askedMs = 0;
        if (tab !== "time") askMore();
      });
      return element("label", { data: { name: field.name } }, box, element("span", {}, field.shown), element("i", {}, unitText(field.unit)));
    }))));
  trigger.offer(controller.fields, controller.states, known()[0]);
  const axis = controller.axes[0];
  for (const [id, wanted] of [["x", `${axis}.voltage_V`], ["y", `${axis}.strain_um`]]) {
    const select = by(id), kept = select.value || wanted;
    select.replaceChildren(...controller.fields.map(({ name }) => new Option(name)));
    select.value = kept;
  }
}

function offerMarks(marks) {
  by("marks-card").hidden = marks.length === 0;
  by("mark-keys").hidden = marks.length === 0;
  by("marks").replaceChildren(...marks.map(([cycle, kind, text]) => {
    const button = element("button", { className: kind }, element("b", {}, moment((cycle - controller.recording.first) * period())), ` ${text}`);
    button.addEventListener("click", () => around(cycle));
    return button;
  }));
}

/** A recording has no trigger, no live values and no other page; it has marks. */
function arrangeRecording({ file, marks, problem }) {
  offerMarks(marks);
  for (const id of ["freeze", "save-recording", "trigger-card", "pages"]) by(id).hidden = true;
  by("where").textContent = file;
  document.title = `${file} - micromanip`;
  noticeRecording({ marks, problem });
}

/** How it ended, and where nothing of it can be read. */
function noticeRecording({ marks, problem }) {
  const damaged = marks.filter(([, kind]) => kind === "damage").length;
  const places = damaged === 1 ? "one place" : `${damaged} places`;
  notice([problem, damaged ? `The file is damaged in ${places}, which are left blank: see the list of marks.` : ""].join(" ").trim(), damaged > 0);
}

/** In the middle; out of a view of all, a twentieth of it. */
function around(cycle) {
  const span = view.span_s >= 0.8 * wholeSpan() ? Math.max(0.001, wholeSpan() / 20) : view.span_s;
  look(cycle + Math.round(span / 2 / period()), span);
}

/** To the next mark after the middle of what is seen, or with -1 to the one before it. */
function jump(direction) {
  const cycles = (controller?.recording?.marks ?? []).map(([cycle]) => cycle);
  const middle = (view.last ?? 0) - view.span_s / 2 / period();
  const found = direction > 0 ? cycles.find((cycle) => cycle > middle + 1) : cycles.findLast((cycle) => cycle < middle - 1);
  if (found !== undefined) around(found);
}

/** What is seen, as a recording; a scope that is live is frozen first. */
async function save() {
  if (!frame) return;
  if (view.last === null) freeze();
  const { first, last } = frame.header;
  try {
    const content = await (await post("/api/recording", { first: Math.max(0, first), last })).blob();
    const link = element("a", { href: URL.createObjectURL(content), download: `scope-${last}.mcap` });
    link.click();
    URL.revokeObjectURL(link.href);
  } catch (problem) {
    notice(problem.message, true);
  }
}

/** Another controller, or a recording. */
function begin(cell) {
  controller = cell;
  view.last = null;
  frame = null;
  if (cell.recording) {
    view = { span_s: wholeSpan(), last: cell.recording.last };
    arrangeRecording(cell.recording);
  }
  chosen ??= ["setpoint_um", "strain_um", "voltage_V"].map((name) => `${cell.axes[0]}.${name}`);
  offer();
  askView();
}

const connection = new Connection((message) => {
  if (message instanceof ArrayBuffer) {
    const [header, arrays] = parsed(message);
    if (header.type === "frame") show(header, arrays);
    else showMore(header, arrays);
  } else if (message.type === "hello") {
    if (message.cell) begin(message.cell);
    return;
  } else if (message.type === "status" && !controller?.recording) {
    showStatus(message);
    const was = isLive;
    isLive = Boolean(message.status);
    if (frame && was !== isLive) summarise(frame.header);
  } else if (message.type === "problem") notice(message.problem, true);
  connection.drawn();
}, (why) => notice(why, true));

for (const span of SPANS) by("span").append(element("option", { value: String(span) }, seconds(span)));
by("span").addEventListener("change", () => {
  if (by("span").value === "other") return;
  view.span_s = Number(by("span").value);
  askView();
});
by("shorter").addEventListener("click", () => zoom(0.5));
by("longer").addEventListener("click", () => zoom(2));
by("earlier").addEventListener("click", () => move(-0.25));
by("later").addEventListener("click", () => move(0.25));
by("freeze").addEventListener("click", freeze);
by("save-recording").addEventListener("click", save);
by("arm").addEventListener("click", () => connection.send({ type: "arm" }));
for (const button of document.querySelectorAll("[data-tab]")) button.addEventListener("click", () => choose(button.dataset.tab));
for (const id of ["x", "y"]) by(id).addEventListener("change", askMore);
by("find").addEventListener("input", () => {
  const wanted = by("find").value.toLowerCase();
  for (const label of by("fields").querySelectorAll("label")) label.hidden = !label.dataset.name.toLowerCase().includes(wanted);
  for (const group of by("fields").children) if (wanted) group.open = true;
});
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches?.("input:not([type=checkbox]), select, button, summary, a")) return;
  const isBox = event.target.matches?.("[type=checkbox]");
  if (isBox && event.key === " ") return;
  const act = isBox && event.key === "Enter" ? () => event.target.click() : {
    " ": freeze, "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), ArrowLeft: () => (event.shiftKey ? shift(-1) : move(-0.25)), ArrowRight: () => (event.shiftKey ? shift(1) : move(0.25)),
    t: () => connection.send({ type: "arm" }),
    n: () => jump(1), p: () => jump(-1),
    a: () => put("A"), b: () => put("B"), c: () => { panels.cursors = { A: null, B: null }; panels.redraw(); showReadout(); },
  }[event.key];
  if (!act) return;
  event.preventDefault();
  act();
});
/** Where the pointer is; without one in the middle, from where shift and the arrows move it. */
function put(name, at = panels.pointer) {
  if (!frame) return;
  newest = name;
  panels.cursors[name] = at ?? (frame.shown[0] + frame.shown[1]) / 2;
  panels.redraw();
  showReadout();
}
function shift(direction) {
  const at = panels.cursors[newest], [from, to] = frame?.shown ?? [0, 0];
  if (at !== null) put(newest, Math.min(to, Math.max(from, at + (direction * (to - from)) / CURSOR_STEPS)));
}
new ResizeObserver(() => {
  spectrum.resize();
  xy.resize();
}).observe(by("plots"));
themeButton(() => {
  panels.redraw();
  spectrum.redraw();
  xy.redraw();
});
