"""``micromanip gateway`` beside a controller of `running_controller`, in a process of its own, and its tokens."""

import json
import signal
import socket
import subprocess
import urllib.request

from campaigns.running_controller import MICROMANIP, until


class RunningGateway:
    """The command, and what a client needs of it: `host`, and `secret` by scope."""

    def __init__(self, cell):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.host = f"127.0.0.1:{free.getsockname()[1]}"
        self.tokens = cell.folder / "tokens"
        self.log = (cell.folder / "gateway.log").open("w+")
        command = [str(MICROMANIP), "gateway", str(cell.config), "--socket", str(cell.socket), "--listen", self.host]
        self.process = subprocess.Popen([*command, "--tokens", str(self.tokens)], stderr=self.log, cwd=cell.folder)
        until(self._listens, lambda: (cell.folder / "gateway.log").read_text())
        lines = [line.split() for line in self.tokens.read_text().splitlines() if not line.startswith("#")]
        self.secret = {scope: secret for _, scope, secret in lines}

    def _listens(self):
        assert self.process.poll() is None
        try:
            self.get("/")
        except OSError:
            return False
        return True

    def get(self, path, scope=None, body=None):
        """What the gateway answers, as text; with `body` it is asked by POST."""
        request = urllib.request.Request(
            f"http://{self.host}{path}", None if body is None else json.dumps(body).encode()
        )
        request.add_header("content-type", "application/json")
        if scope is not None:
            request.add_header("authorization", f"Bearer {self.secret[scope]}")
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.read().decode()

    def state(self):
        """The controller's state as the gateway knows it; None without a controller."""
        told = json.loads(self.get("/api/status", "observe"))
        return told["status"] and told["status"]["state"]

    def close(self):
        """End it."""
        self.process.terminate()
        assert self.process.wait(20) in (0, -signal.SIGTERM, -signal.SIGKILL)
        self.log.close()
