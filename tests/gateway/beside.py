"""What is served beside the pages, in a thread of its own, before a cell whose status the test says."""

import asyncio
import socket
import threading


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Beside:
    """Runs `serving()` of a service until it is closed."""

    def __init__(self, cell, service):
        self.cell = cell
        self._loop, self._ready, self._over = asyncio.new_event_loop(), threading.Event(), None
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._serve(service),))
        self._thread.start()
        assert self._ready.wait(60)

    async def _serve(self, service):
        self._over = asyncio.Event()
        async with service.serving():
            self._ready.set()
            await self._over.wait()

    def say(self, told):
        """The controller's status is `told` from now on."""

        def tell():
            self.cell.status, self.cell.problem = told, None if told else "no controller answers"
            for listener in list(self.cell.listeners):
                listener(None)

        self._loop.call_soon_threadsafe(tell)

    def close(self):
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(30)
        assert not self._thread.is_alive()
        self._loop.close()
