"""A headless Chromium, driven by its own protocol over one websocket."""

import contextlib
import json
import shutil
import subprocess
import time
import urllib.request

from websockets.sync.client import connect

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class Chromium:
    """One page; `errors` are what its console and network complain of, `asked` every address it asked for."""

    def __init__(self, socket):
        self._socket, self._number = socket, 0
        self.errors, self.asked = [], []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self(f"{domain}.enable")

    def __call__(self, method, **parameters):
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (message := json.loads(self._socket.recv(60))).get("id") != self._number:
            self._note(message["method"], message["params"])
        assert "error" not in message, message
        return message["result"]

    def _note(self, method, told):
        if method == "Network.requestWillBeSent":
            self.asked.append(told["request"]["url"])
        elif method in ("Runtime.exceptionThrown", "Network.webSocketFrameError"):
            self.errors.append(told)
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(told["entry"])
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning", "assert"):
            self.errors.append(told)

    def value(self, script):
        """What the script amounts to; a promise is waited for."""
        told = self("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def until(self, script, patience_s=60.0):
        """Wait until the script amounts to something true; it."""
        end = time.monotonic() + patience_s
        while not (found := self.value(script)):
            assert time.monotonic() < end, f"never true: {script}; {self.errors}"
            time.sleep(0.05)
        return found


@contextlib.contextmanager
def chromium(folder, width=1280, height=900):
    """A browser of its own, with one page."""
    with subprocess.Popen(
        [PROGRAM, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--no-first-run",
         "--remote-allow-origins=*", f"--user-data-dir={folder}", f"--window-size={width},{height}", "about:blank"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            line = next(line for line in process.stderr if "DevTools listening" in line)
            port = line.partition("127.0.0.1:")[2].partition("/")[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as told:
                page = next(target for target in json.load(told) if target["type"] == "page")
            with connect(page["webSocketDebuggerUrl"], max_size=None) as socket:
                yield Chromium(socket)
        finally:
            process.terminate()
