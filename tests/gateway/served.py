"""A gateway on a real port, before a ring that is played."""

import asyncio
import contextlib
import socket
import threading

import uvicorn

from campaigns.running_controller import until
from micromanip.gateway.impatient import Impatient


def follow(played):
    """Let its cell take in what is played, and say so twenty times a second."""

    async def run():
        while True:
            played.read()
            played.cell._notify(None)
            await asyncio.sleep(0.05)

    played.cell.follow = run


@contextlib.contextmanager
def served(gateway):
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        config = uvicorn.Config(
            gateway.guard, http=Impatient, ws="websockets-sansio", log_level="error", timeout_graceful_shutdown=1
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        until(lambda: server.started, "it listens", 60.0)
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        server.should_exit = True
        thread.join()
