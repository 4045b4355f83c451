"""An event loop that runs beside the test; what concerns its devices is done in its own thread."""

import os
import queue
import threading

PATIENCE_S = 20.0


class LoopInThread:
    """Runs `loop` from now on, until ``end``."""

    def __init__(self, loop):
        self._loop, self._calls = loop, queue.SimpleQueue()
        self._bell = os.eventfd(0, os.EFD_NONBLOCK)
        loop.add_reader(self._bell, self._serve)
        self._thread = threading.Thread(target=loop.run)
        self._thread.start()

    def do(self, call):
        """Have `call` made by the loop's thread."""
        self._calls.put(call)
        os.eventfd_write(self._bell, 1)

    def ask(self, call):
        """Have `call` made by the loop's thread, and wait for what it returns."""
        answer = queue.SimpleQueue()
        self.do(lambda: answer.put(call()))
        return answer.get(timeout=PATIENCE_S)

    def end(self):
        """The loop stands still afterwards."""
        self._loop.stop()
        self._thread.join()
        os.close(self._bell)

    def _serve(self):
        os.eventfd_read(self._bell)
        while not self._calls.empty():
            self._calls.get()()
