// The trigger's form: what it says as the message to the gateway.
import { offer } from "./page.js";

export class TriggerForm {
  constructor(form, changed) {
    this.form = form;
    form.addEventListener("input", () => {
      this.arrange();
      clearTimeout(this.waiting);
      this.waiting = setTimeout(changed, 250);
    });
    form.addEventListener("submit", (event) => event.preventDefault());
    this.arrange();
  }

  /** The fields and states of the cell; `first` is chosen where nothing was before. */
  offer(fields, states, first) {
    const field = this.form.elements.field, kept = field.value;
    field.replaceChildren(...fields.map(({ name }) => new Option(name)));
    field.value = fields.some(({ name }) => name === kept) ? kept : first ?? fields[0].name;
    const state = this.form.elements.state;
    if (!state.options.length) {
      state.replaceChildren(...states.map((name) => new Option(name)));
      state.value = "FAULT";
    }
  }

  arrange() {
    offer(this.form);
    this.form.querySelector("button").disabled = this.mode === "off";
  }

  get mode() {
    return this.form.elements.mode.value;
  }

  /** As the gateway wants it; null where it is off. */
  get query() {
    const e = this.form.elements;
    if (this.mode === "off") return null;
    const query = { mode: this.mode, kind: e.kind.value, before: Math.min(100, Math.max(0, e.before.valueAsNumber || 0)) / 100 };
    if (["edge", "window"].includes(query.kind)) query.field = e.field.value;
    if (query.kind === "edge") Object.assign(query, { slope: e.slope.value, level: e.level.valueAsNumber });
    if (query.kind === "window") Object.assign(query, { low: e.low.valueAsNumber, high: e.high.valueAsNumber });
    if (query.kind === "state") query.state = e.state.value;
    return query;
  }
}
