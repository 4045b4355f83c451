// The live connection. The token goes into the first message, never into an address; it is kept for this tab only.
import { Orders } from "./orders.js";
import { by, element } from "./page.js";

const KEPT = "token";
const AGAIN_MS = 1000;
const WRONG = 1008;

export const token = () => sessionStorage.getItem(KEPT) ?? "";

/** Ask for a token; resolves when one was given. */
function asked(why) {
  const input = element("input", { type: "password", autocomplete: "off", required: true, id: "token" });
  const dialog = element("dialog", {},
    element("form", { method: "dialog" },
      element("h1", {}, "Token"),
      element("p", { className: "faint" }, "Tokens stand in a file on the computer that runs the gateway; it names the file as it starts. One token only observes, the other operates."),
      element("label", { htmlFor: "token" }, "Token"), input,
      element("div", { className: "notice bad", hidden: !why }, why),
      element("div", { className: "choices" }, element("button", {}, "Open"))));
  dialog.addEventListener("cancel", (event) => event.preventDefault());
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((resolve) => dialog.addEventListener("close", () => {
    sessionStorage.setItem(KEPT, input.value.trim());
    dialog.remove();
    resolve();
  }));
}

/** Why the gateway, or a proxy before it, let no live connection begin; null where nothing answers. */
async function refusal() {
  const answer = await fetch("/live").catch(() => null);
  if (answer === null) return null;
  const text = (await answer.text().catch(() => "")).trim();
  return [403, 426, 503].includes(answer.status) && text.length < 300 ? text : `The answer is ${answer.status}`;
}

/** Stays connected; `hear` gets each message, text as an object and binary as it is, `lost` how it broke off. */
export class Connection {
  constructor(hear, lost) {
    this.hear = hear;
    this.lost = lost;
    this.orders = new Orders(post);
    this.socket = null;
    this.failed = 0; // tries in a row that brought nothing
    by("forget").addEventListener("click", () => {
      sessionStorage.removeItem(KEPT);
      location.reload();
    });
    this.begin();
  }

  /** The first try is without a token where none is kept: who shows a recording asks for none. */
  async begin(why = null) {
    if (why !== null) await asked(why);
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => socket.send(JSON.stringify({ type: "hello", token: token() })));
    socket.addEventListener("message", (event) => {
      this.socket = socket;
      const message = typeof event.data === "string" ? JSON.parse(event.data) : event.data;
      if (message.type === "hello") {
        by("who").textContent = `${message.name} (${message.scope === "operate" ? "operates" : "observes"})`;
        by("forget").hidden = !token();
      }
      this.orders.hear(message);
      this.hear(message);
    });
    socket.addEventListener("close", async (event) => {
      this.failed = this.socket === null ? this.failed + 1 : 0;
      this.socket = null;
      // once may be a gateway that was just starting
      const refused = this.failed > 1 && event.code !== WRONG ? await refusal() : null;
      if (event.code === WRONG) {
        const unknown = token() ? "This token is not known here." : "";
        sessionStorage.removeItem(KEPT);
        this.failed = 0;
        this.begin(unknown);
      } else {
        this.orders.arrange(null);
        this.lost(`${refused ?? "The gateway does not answer"}; trying again.`);
        setTimeout(() => this.begin(), AGAIN_MS);
      }
    });
  }

  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  drawn() {
    this.send({ type: "drawn" });
  }
}

/** POST of a document; the response, or an Error with what the gateway says. */
export async function post(path, document) {
  const response = await fetch(path, {
    method: "POST",
    headers: { "content-type": "application/json", authorization: `Bearer ${token()}` },
    body: JSON.stringify(document),
  }).catch(() => {
    throw new Error("The gateway does not answer: whether this was done is not known.");
  });
  if (response.ok) return response;
  const said = await response.json().catch(() => ({ error: `the gateway answers ${response.status}` }));
  throw new Error(said.error);
}
