"""A control socket that says which configuration runs."""

import json

from tests.cli.played import Played

TEXT, HASH = "loop: {rate_hz: 10000}\n", "a" * 64


class Answering(Played):
    def _serve(self, connection):
        with connection.makefile("rb") as lines:
            for line in lines:
                assert json.loads(line)["verb"] == "configuration"
                told = {"version": 1, "ok": True, "result": {"text": TEXT, "sha256": HASH}}
                connection.sendall(json.dumps(told).encode() + b"\n")
