"""A device over TCP that starts anew with each connection, and hears nothing until it has started."""

import socket
import threading
import time


class StartingDevice:
    """``answer(data)`` says what it answers; `greeting` is sent at once. Counts the connections that it had."""

    def __init__(self, answer, start_s, greeting=b""):
        self.answer, self.start_s, self.greeting = answer, start_s, greeting
        self.connections = 0
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]

    def __enter__(self):
        threading.Thread(target=self._serve, daemon=True).start()
        return self

    def __exit__(self, *raised):
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()

    def _serve(self):
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            self.connections += 1
            with connection:
                ready = time.monotonic() + self.start_s
                connection.sendall(self.greeting)
                while data := connection.recv(4096):
                    if time.monotonic() >= ready:
                        connection.sendall(self.answer(data))
