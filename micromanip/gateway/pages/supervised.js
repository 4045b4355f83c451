// What the pages share that let an axis move: who may, where, what is seen meanwhile, and that it ends with the page.
import { Connection } from "./connection.js";
import { parsed } from "./frames.js";
import { by, notice } from "./page.js";

/** Ask the person first; enter means no. */
export async function isMeant(title, text) {
  const dialog = by("question");
  dialog.querySelector("h1").textContent = title;
  dialog.querySelector("p").textContent = text;
  dialog.returnValue = "no";
  dialog.showModal();
  dialog.querySelector('[value="no"]').focus();
  await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
  return dialog.returnValue === "yes";
}

/** The cell as this page knows it; its axes are choices of `axis`.
 *
 * `draw` gets frames, `look` is called for each new cell, `arrange` where what may be done has changed, and `stop` where
 * it must end: by escape, the button, a page that is hidden, or a connection that is lost.
 */
export class Supervised {
  constructor({ axis, draw, look, arrange, stop }) {
    this.controller = null;
    this.state = "";
    this.operates = false;
    this.told = { axis, draw, look, arrange, stop };
    this.connection = new Connection((message) => this.hear(message), (why) => {
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
  }

  hear(message) {
    const { axis, draw, look, arrange } = this.told;
    if (message instanceof ArrayBuffer) {
      const [header, arrays] = parsed(message);
      if (header.type === "frame") draw(header, arrays);
      this.connection.drawn();
    } else if (message.type === "hello") {
      this.operates = message.scope === "operate";
      this.controller = message.cell;
      if (this.controller) {
        const kept = axis.value;
        axis.replaceChildren(...this.controller.axes.map((name) => new Option(name)));
        if (this.controller.axes.includes(kept)) axis.value = kept;
        look();
      }
      arrange();
    } else if (message.type === "status") {
      this.state = message.status?.state ?? "";
      by("state").textContent = this.state || "NO CONTROLLER";
      by("where").textContent = message.status?.configuration ?? "";
      const fault = message.status?.fault_reports.at(-1);
      notice(message.problem ?? (fault ? `${fault.seen}. ${fault.next_step}` : message.differs ?? ""), Boolean(message.problem ?? fault));
      arrange();
      this.connection.drawn();
    } else if (message.type === "problem") {
      notice(message.problem, true);
      this.connection.drawn();
    }
  }
}
