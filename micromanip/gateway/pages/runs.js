// Recordings, trips, days of a trend, reports and tunings: what the catalogue finds, and reports to open.
import { Connection, post } from "./connection.js";
import { by, element, figure, notice, seconds, themeButton } from "./page.js";

const TYPING_MS = 250;
const AGAIN_MS = 1000;
const LIVE = ["text", "fault", "configuration", "above_um"];

let asked = 0;
let waiting = null;

/** What the form asks; null is anything. */
function question() {
  const told = {};
  for (const [name, value] of new FormData(by("question"))) {
    told[name] = value.trim() === "" ? null : name === "above_um" ? Number(value) : value.trim();
  }
  return { ...told, most: 200 };
}

async function find() {
  clearTimeout(waiting);
  const number = ++asked;
  try {
    const answer = await (await post("/api/runs", question())).json();
    if (number !== asked) return;
    show(answer);
    if (answer.refreshing) waiting = setTimeout(find, AGAIN_MS);
  } catch (problem) {
    if (number === asked) notice(problem.message, true);
  }
}

function show(answer) {
  notice(answer.problem ?? "", true);
  const more = answer.refreshing ? "; looking for new ones ..." : "";
  by("count").textContent = `${answer.found.length} of ${answer.entries}${more}`;
  by("folders").textContent = `in ${answer.folders.join(", ")}`;
  const had = document.activeElement?.closest("article")?.dataset.path;
  by("found").replaceChildren(...answer.found.map(shown));
  if (had) [...by("found").children].find((one) => one.dataset.path === had)?.focus();
  if (!answer.found.length) by("found").append(element("p", { className: "faint" }, answer.entries ? "Nothing like that." : "Nothing was found in these folders yet."));
}

function shown(entry) {
  const errors = Object.entries(entry.rms_um).map(([axis, rms]) => `${axis} ${figure(rms, 2)}`).join(", ");
  const cut = entry.path.lastIndexOf("/") + 1;
  return element("article", { className: "card run", tabIndex: -1, data: { path: entry.path, kind: entry.kind } },
    element("h2", {}, element("span", { className: "kind" }, entry.kind), element("b", {}, entry.path.slice(cut)),
      element("time", { dateTime: entry.began }, `${entry.began.slice(0, 19).replace("T", " ")} UTC`)),
    element("p", { className: "figures" },
      entry.seconds === null ? null : element("span", {}, seconds(entry.seconds, 4)),
      errors ? element("span", {}, `error rms ${errors} µm`) : null,
      ...entry.faults.map((code) => element("b", { className: "code" }, code)),
      entry.configuration ? element("span", { className: "faint" }, entry.configuration.slice(0, 12)) : null),
    entry.about ? element("p", {}, entry.about) : null,
    entry.problem ? element("p", { className: "wrong" }, entry.problem) : null,
    element("p", { className: "ways" }, ...ways(entry)));
}

/** What can be done with it: a report is opened here, all else is a command. */
function ways(entry) {
  const quoted = `'${entry.path.replaceAll("'", "'\\''")}'`;
  const commands = { recording: ["view", "replay"], trip: ["explain"], trend: ["trend"], tuning: ["check"] }[entry.kind] ?? [];
  const open = element("button", { type: "button" }, entry.kind === "recording" ? "Make its report" : "Open");
  open.addEventListener("click", () => report(open, entry.path));
  return [...(["recording", "report"].includes(entry.kind) ? [open] : []),
    ...commands.map((verb) => element("code", {}, `micromanip ${verb} ${quoted}`))];
}

/** The tab is opened at once, for a browser lets nobody open one later. */
async function report(button, path) {
  const tab = window.open("", "_blank");
  button.disabled = true;
  try {
    const { address } = await (await post("/api/runs/report", { path })).json();
    if (tab) tab.location = address;
  } catch (problem) {
    tab?.close();
    notice(problem.message, true);
  } finally {
    button.disabled = false;
  }
}

function typed() {
  clearTimeout(waiting);
  waiting = setTimeout(find, TYPING_MS);
}

by("question").addEventListener("submit", (event) => { event.preventDefault(); find(); });
by("question").addEventListener("input", (event) => (LIVE.includes(event.target.name) ? typed() : find()));
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || document.querySelector("dialog[open]")) return;
  if (event.key === "Escape") document.activeElement.blur();
  if (["INPUT", "SELECT"].includes(event.target.tagName)) return;
  const all = [...by("found").querySelectorAll("article")];
  const at = all.indexOf(document.activeElement?.closest("article"));
  if (event.key === "/") by("question").elements.text.focus();
  else if (event.key === "j") all[Math.min(at + 1, all.length - 1)]?.focus();
  else if (event.key === "k") all[Math.max(at - 1, 0)]?.focus();
  else if (event.key === "Enter" && event.target.tagName === "ARTICLE") event.target.querySelector("button")?.click();
  else return;
  event.preventDefault();
});

themeButton();
const connection = new Connection((message) => {
  if (message.type === "hello") find();
  if (message.type === "status") {
    by("state").textContent = message.status?.state ?? "NO CONTROLLER";
    connection.drawn();
  }
}, (why) => notice(why, true));
