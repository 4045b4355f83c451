"""A small broker of MQTT 3.1.1: sessions, wills, retained messages; and a client that listens to a broker."""

import contextlib
import shutil
import socket
import ssl
import subprocess
import threading

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from campaigns.running_controller import until

from .beside import free_port

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
_CONNECT, _PUBLISH, _SUBSCRIBE, _PING, _DISCONNECT = 1, 3, 8, 12, 14


def matches(wanted, topic):
    wanted, topic = wanted.split("/"), topic.split("/")
    for k, part in enumerate(wanted):
        if part == "#":
            return True
        if k >= len(topic) or part not in ("+", topic[k]):
            return False
    return len(wanted) == len(topic)


class SmallBroker:
    """What a test can spoil: `login` asks for a password, `tls` is its certificate and key, `is_deaf` never answers."""

    def __init__(self, port=0, login=None, tls=None, is_deaf=False):
        self._login, self._is_deaf, self._context = login, is_deaf, None
        if tls is not None:
            self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._context.load_cert_chain(*tls)
        self._sessions, self._retained, self._lock, self.attempts = {}, {}, threading.RLock(), 0
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self):
        """As a broker that is killed: no will, no farewell."""
        self._listener.close()
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            pass  # wakes the thread that accepts
        with self._lock:
            for connection in list(self._sessions):
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def cut_off_others(self, host):
        """As a network that is gone for everybody but `host`."""
        with self._lock:
            for connection, wanted in list(self._sessions.items()):
                if host.WANTED not in wanted:
                    connection.shutdown(socket.SHUT_RDWR)

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self.attempts += 1
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection):
        will = None
        with self._lock:
            self._sessions[connection] = []
        with contextlib.suppress(OSError, EOFError):
            if self._context is not None:
                plain, connection = connection, self._context.wrap_socket(connection, server_side=True)
                with self._lock:
                    self._sessions[connection] = self._sessions.pop(plain)
            while True:
                kind, flags, body = packet(connection)
                if self._is_deaf:
                    continue
                if kind == _CONNECT:
                    will, login = connect_fields(body)
                    refused = 5 if self._login is not None and login != self._login else 0
                    connection.sendall(bytes([0x20, 2, 0, refused]))
                elif kind == _SUBSCRIBE:
                    self._subscribe(connection, body)
                elif kind == _PUBLISH:
                    topic, rest = text(body)
                    if (flags >> 1) & 3:
                        connection.sendall(bytes([0x40, 2]) + rest[:2])
                        rest = rest[2:]
                    self.publish(topic, rest, retain=bool(flags & 1))
                elif kind == _PING:
                    connection.sendall(bytes([0xD0, 0]))
                elif kind == _DISCONNECT:
                    will = None
                    break
        with self._lock:
            self._sessions.pop(connection, None)
        connection.close()
        if will is not None:
            self.publish(*will)

    def _subscribe(self, connection, body):
        number, body, wanted = body[:2], body[2:], []
        while body:
            topic, body = text(body)
            wanted.append(topic)
            body = body[1:]
        with self._lock:
            self._sessions[connection] += wanted
            connection.sendall(bytes([0x90, 2 + len(wanted)]) + number + bytes(len(wanted)))
            for topic, content in self._retained.items():
                if any(matches(each, topic) for each in wanted):
                    connection.sendall(published(topic, content))

    def publish(self, topic, content, retain=False):
        with self._lock:
            if retain:
                self._retained[topic] = content
            for connection, wanted in list(self._sessions.items()):
                if any(matches(each, topic) for each in wanted):
                    with contextlib.suppress(OSError):
                        connection.sendall(published(topic, content))


def published(topic, content):
    body = len(topic).to_bytes(2, "big") + topic.encode() + content
    length, left = b"", len(body)
    while True:
        left, digit = divmod(left, 128)[0], left % 128
        length += bytes([digit | 0x80 if left else digit])
        if not left:
            return b"\x30" + length + body


def exactly(connection, count):
    got = b""
    while len(got) < count:
        more = connection.recv(count - len(got))
        if not more:
            raise EOFError
        got += more
    return got


def packet(connection):
    first, length, shift = exactly(connection, 1)[0], 0, 0
    while True:
        digit = exactly(connection, 1)[0]
        length |= (digit & 127) << shift
        shift += 7
        if digit < 128:
            return first >> 4, first & 15, exactly(connection, length)


def text(body):
    end = 2 + int.from_bytes(body[:2], "big")
    return body[2:end].decode(), body[end:]


def connect_fields(body):
    """The will as (topic, content) or None, and (user, password)."""
    _, rest = text(body)
    flags, rest = rest[1], rest[4:]
    _, rest = text(rest)
    will, login = None, []
    if flags & 4:
        topic, rest = text(rest)
        end = 2 + int.from_bytes(rest[:2], "big")
        will, rest = (topic, rest[2:end]), rest[end:]
    for bit in (0x80, 0x40):
        value = None
        if flags & bit:
            value, rest = text(rest)
        login.append(value)
    return will, tuple(login)


class Mosquitto:
    """Debian's broker, in the foreground."""

    def __init__(self, folder, port=0, more=""):
        self.port = port or free_port()
        config = folder / "mosquitto.conf"
        config.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n{more}")
        self._process = subprocess.Popen([MOSQUITTO, "-c", str(config)], stderr=subprocess.DEVNULL)
        until(self._listens, "mosquitto listens")

    def _listens(self):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True

    def close(self):
        self._process.kill()
        self._process.wait(10)


class Host:
    """A host application: hears everything of Sparkplug, and may say something."""

    WANTED = "spBv1.0/#"

    def __init__(self, port):
        self.messages = []
        self._client = Client(CallbackAPIVersion.VERSION2)
        subscribed = threading.Event()
        self._client.on_connect = lambda client, *_: client.subscribe(self.WANTED)
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.on_message = lambda _c, _u, m: self.messages.append((m.topic, bytes(m.payload)))
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert subscribed.wait(10)

    def say(self, topic, content, retain=False):
        self._client.publish(topic, content, 1, retain).wait_for_publish(10)

    def heard(self, kind):
        """Payloads of messages of this kind, so far."""
        return [content for topic, content in list(self.messages) if topic.split("/")[2] == kind]

    def close(self):
        self._client.disconnect()
        self._client.loop_stop()
