// What the pages share that let an axis move: who may, where, what is seen meanwhile, and that it ends with the page.
import { Connection } from "./connection.js";
import { parsed } from "./frames.js";
import { by, notice, showStatus } from "./page.js";

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
    this.page = { axis, draw, look, arrange, stop };
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
    const { axis, draw, look, arrange } = this.page;
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
      showStatus(message);
      arrange();
      this.connection.drawn();
    } else if (message.type === "problem") {
      notice(message.problem, true);
      this.connection.drawn();
    }
  }
}
