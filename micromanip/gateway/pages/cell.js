// The cell page: state, faults, axes, timing, links.
import { Connection, post } from "./connection.js";
import { by, cell, count, element, figure, head, notice, rows, themeButton } from "./page.js";

const MEANING = {
  OFF: "ended", STARTING: "starting", READY: "at rest, waits for ARM", ARMING: "lifting, closing the loops",
  TRACKING: "correcting", HOLDING: "frozen, loops closed", RAMPING: "on its way to park",
  FAULT: "stopped by a fault", "NO CONTROLLER": "nothing below is known",
};
const QUANTITIES = [
  ["position", "position_um", "µm", 2], ["set-point", "setpoint_um", "µm", 2], ["strain", "strain_um", "µm", 2],
  ["voltage", "voltage_V", "V", 2], ["headroom", "headroom_V", "V", 2],
];
const TIGHT_V = 5;
let operates = false;
let range = {};

function show(message) {
  const status = message.status;
  const state = status ? status.state : "NO CONTROLLER";
  const banner = by("state");
  if (banner.dataset.state !== state) {
    banner.dataset.state = state;
    banner.firstChild.textContent = state;
    document.title = `${state} - micromanip`;
  }
  const silent = message.silent_s > 0 ? `, last heard of ${message.silent_s.toFixed(0)} s ago` : "";
  banner.lastChild.textContent = (message.unseen && !status ? "the fault that it had is below" : MEANING[state] ?? "") + silent;
  notice(message.problem ?? message.differs ?? "", Boolean(message.problem));
  showFaults(message);
  by("axes").hidden = !status;
  document.querySelector(".more").hidden = !status;
  if (!status) return;
  by("where").textContent = status.configuration;
  showAxes(status.axes);
  showTiming(status);
  showLinks(status.links);
  showSignals(status.signals);
  showRun(status);
}

/** The faults that are latched; else those of a controller that is gone, until somebody has seen them. */
function showFaults({ status, unseen }) {
  const { fault_reports: faults, trips: files } = unseen ?? status ?? { fault_reports: [], trips: [] };
  by("faults").hidden = faults.length === 0;
  const shown = JSON.stringify([faults, files, Boolean(unseen)]);
  if (by("faults").dataset.shown === shown) return;
  by("faults").dataset.shown = shown;
  const trips = Object.fromEntries(files.map((trip) => [trip.code, trip.file]));
  by("faults").replaceChildren(...faults.map((fault) => element("article", { className: "card fault" },
    element("h2", {}, fault.seen),
    fault.next_step ? element("p", { className: "next" }, element("b", {}, "Next step: "), fault.next_step) : null,
    fault.likely_causes.length ? element("div", {}, "Likely:", element("ul", {}, ...fault.likely_causes.map((cause) => element("li", {}, cause)))) : null,
    element("p", { className: "faint" }, [fault.cycle === null ? "" : `cycle ${fault.cycle}`, trips[fault.code] ? `black box ${trips[fault.code]}` : ""].filter(Boolean).join(", ")))));
  if (!unseen || !operates) return;
  const seen = element("button", { id: "seen" }, "Seen");
  seen.addEventListener("click", () => post("/api/seen", {}).catch((problem) => notice(problem.message, true)));
  by("faults").append(element("p", {}, "The controller that had this fault is gone. ", seen));
}

function showAxes(axes) {
  by("axes").replaceChildren(...Object.entries(axes).map(([name, axis]) => {
    const second = axis.error_um.second;
    const known = axis.error_um.latest !== null && second;
    const [low, high] = range[name] ?? [0, 1];
    const headroom = axis.headroom_V.latest;
    return element("article", { className: "card axis", title: axis.less ? `PASS WITH LESS: ${axis.less}` : "" },
      element("h2", {}, element("b", {}, name), axis.untuned ? "UNTUNED, open loop" : axis.error_of ? `${axis.error_of} error` : "open loop"),
      element("div", { className: "error" }, known ? figure(second.rms) : "–", element("small", {}, " µm rms, 1 s")),
      element("div", { className: known ? "faint" : "unknown" }, known ? `peak ${figure(second.peak)} µm in 1 s, ${figure(axis.error_um.minute?.rms)} µm rms in 1 min` : axis.error_um.unknown ?? ""),
      ...(axis.swing ? [element("div", { className: "unknown" }, `swings by ${figure(axis.swing.um)} µm at ${figure(axis.swing.Hz, 1)} Hz, reference held`)] : []),
      element("table", {}, ...QUANTITIES.filter(([, key]) => !axis[key].unknown?.startsWith("no signal")).map(([said, key, unit, digits]) => {
        const value = axis[key];
        const tight = key === "headroom_V" && value.latest !== null && value.latest < TIGHT_V;
        return element("tr", { title: value.unknown ?? "" },
          cell(said), cell(value.latest === null ? "unknown" : figure(value.latest, digits), `number${value.latest === null || tight ? " unknown" : ""}`), cell(unit));
      })),
      element("meter", { min: 0, max: (high - low) / 2, low: TIGHT_V, optimum: (high - low) / 2, value: headroom ?? 0, title: `voltage headroom, ${low} to ${high} V`, ariaLabel: `headroom of ${name}` }));
  }));
}

const us = (ns) => (ns < 1e6 ? figure(ns * 1e-3, 1) : count(Math.round(ns * 1e-3)));

function showTiming(status) {
  const line = (said, d) => [cell(said), ...["p50", "p99_9", "max"].map((key) => cell(us(d[key]), "number"))];
  rows(by("timing"), [
    [head("µs"), head("p50", "number"), head("p99.9", "number"), head("max", "number")],
    line("lateness", status.lateness_ns), line("compute", status.compute_ns),
    [cell("overruns"), cell(count(status.overruns), "number"), element("td", { colSpan: 2, className: "number" }, `of ${count(status.cycles)} cycles`)],
  ]);
}

function showLinks(links) {
  const entries = Object.entries(links);
  by("links-card").hidden = entries.length === 0;
  rows(by("links"), entries.map(([name, link]) => [
    head(name), cell(link.link, link.link === "up" ? "" : "unknown"), cell(`outputs ${link.outputs}`), cell(link.message ?? ""),
  ]));
}

function showSignals(signals) {
  rows(by("signals"), [
    [head(""), head("Hz", "number"), head("age p99.9, µs", "number"), head("lost", "number"), head("stale", "number")],
    ...Object.entries(signals).map(([name, signal]) => [
      cell(name), cell(figure(signal.rate_hz, 0), "number"), cell(figure(signal.age_p99_9_us, 0), "number"),
      cell(String(signal.lost), "number"), cell(String(signal.stale_cycles), "number"),
    ]),
  ]);
}

function showRun(status) {
  const recording = status.recording;
  rows(by("run"), [
    [cell("running for"), cell(`${figure(status.cycles * status.period_ns * 1e-9, 1)} s`)],
    [cell("period"), cell(`${status.period_ns / 1000} µs`)],
    [cell("parameter version"), cell(String(status.parameter_version))],
    [cell("candidate tuning"), cell(status.candidate)],
    [cell("recording"), cell(recording ? `${recording.state}, ${count(recording.rows)} rows, ${count(recording.dropped)} dropped` : "none")],
  ]);
}

const connection = new Connection((message) => {
  if (message.type === "hello") {
    operates = message.scope === "operate";
    range = message.cell?.range_V ?? {};
  } else if (message.type === "status") {
    show(message);
    connection.drawn();
  }
}, (why) => show({ status: null, problem: why, silent_s: 0 }));

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches?.("input, select")) return;
  const name = { a: "arm", h: "hold", d: "disarm", r: "reset" }[event.key];
  if (name) connection.orders.give(name);
});
themeButton();
