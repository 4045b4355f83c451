// Orders to the cell, each after a question: HOLD and DISARM on every page, ARM and RESET on the cell's.
import { by, isMeant } from "./page.js";

const QUESTIONS = {
  arm: ["Arm the cell?", "It begins to move."],
  hold: ["Hold?", "The correction is frozen where it is, the loops stay closed. ARM goes on."],
  disarm: ["Disarm?", "Every output ramps to its park voltage."],
  reset: ["Clear the latched fault?", "Nothing moves."],
};
const STOPS = ["hold", "disarm"];
const FAULTED = "ARM comes after RESET: mend what the fault says, then reset it.";

export class Orders {
  /** `post` sends a document to a path of the gateway. */
  constructor(post) {
    this.post = post;
    this.operates = false;
    this.buttons = [...by("orders").querySelectorAll("button")];
    for (const button of this.buttons) button.addEventListener("click", () => this.give(button.dataset.order));
  }

  hear(message) {
    if (message.type === "hello") {
      this.operates = message.scope === "operate";
      by("orders").hidden = !this.operates;
    } else if (message.type === "status") this.arrange(message.status?.state ?? null);
  }

  /** Nobody takes orders where no controller is (`state` null); a fault is reset before anything moves again. */
  arrange(state) {
    for (const button of this.buttons) {
      const first = state === "FAULT" && button.dataset.order === "arm" ? FAULTED : "";
      button.disabled = state === null || !this.operates || Boolean(first);
      button.title = first;
    }
    const told = by("ordered"), isHere = state === "FAULT" && document.body.dataset.page === "cell";
    if (isHere || told.textContent === FAULTED) told.textContent = isHere ? FAULTED : "";
  }

  async give(name) {
    if (by("question").open || this.buttons.find((button) => button.dataset.order === name).disabled) return;
    if (!(await isMeant(...QUESTIONS[name], STOPS.includes(name) ? "yes" : "no"))) return;
    by("ordered").textContent = `${name} ...`;
    try {
      await this.post("/api/order", { order: name });
      by("ordered").textContent = `${name}: done`;
    } catch (problem) {
      by("ordered").textContent = problem.message;
    }
  }
}
