"""The control socket takes anything from anybody, and answers each line on its own."""

import asyncio
import contextlib
import errno
import grp
import json
import os
import socket
import stat
import struct
import time
from pathlib import Path

import pytest

from micromanip.client import Client
from micromanip.errors import CheckFailed, DeviceUnavailable, PermissionDenied
from micromanip.host.control import socket_file
from micromanip.host.control.admission import Bounds
from micromanip.host.control.authority import Authority, Peer, Right
from micromanip.host.control.request import Verb
from micromanip.host.control.server import ControlSocket
from micromanip.host.control.socket_file import Access, bound, claim, remove_stale

LIMIT = 65536
ECHO = {"version": 1, "ok": True, "result": "here"}


async def _here(_request):
    return "here"


async def _refused(_request):
    raise CheckFailed("refused: the state is OFF")


async def _broken(_request):
    raise ZeroDivisionError("float division by zero")


async def _long(_request):
    return "x" * 50_000


VERBS = {
    "here": Verb(_here, Right.OBSERVE),
    "refused": Verb(_refused, Right.OPERATE),
    "broken": Verb(_broken, Right.OPERATE),
    "long": Verb(_long, Right.OBSERVE),
    "disarm": Verb(_here, Right.OPERATE, stops=True),
}


def talk(path, conversation, access=Access(), bounds=Bounds()):  # noqa: B008
    """Serve, run `conversation(reader, writer)` against it, close."""

    async def main():
        served = ControlSocket(path, VERBS, access, bounds)
        await served.open()
        try:
            reader, writer = await asyncio.open_unix_connection(str(path), limit=1 << 22)
            try:
                return await asyncio.wait_for(conversation(reader, writer), 120)
            finally:
                writer.close()
        finally:
            served.close()

    return asyncio.run(main())


def answers(path, lines):
    """What is answered to `lines`, sent as they are, one after the other."""

    async def conversation(reader, writer):
        heard = []
        for line in lines:
            writer.write(line + b"\n")
            heard.append(json.loads(await reader.readline()))
        return heard

    return talk(path, conversation)


HERE = b'{"version": 1, "verb": "here"}'


REFUSED = {
    "not JSON": (b"arm!", "not a line of JSON: Expecting value"),
    "nested without end": (b"[" * 60_000, "not a line of JSON: "),
    "nested deeply": (b'{"version": 1, "verb": "here", "x": ' + b"[" * 33 + b"]" * 33 + b"}", "a request is nested at"),
    "number too long": (b'{"version": ' + b"1" * 5000 + b"}", "not a line of JSON: a number of 5000 digits"),
    "not an object": (b"[1]", 'a request is a JSON object with "version": 1'),
    "wrong version": (b'{"version": 2, "verb": "here"}', "version 2 of the protocol is not supported; supported is 1"),
    "not a number": (
        b'{"version": 1, "verb": "here", "x": NaN}',
        "expected finite numbers, not NaN; where no limit is meant",
    ),
    "two verbs": (b'{"version": 1, "verb": "here", "verb": "disarm"}', "the key 'verb' is given twice; leave one"),
    "a value given twice": (
        b'{"version": 1, "verb": "here", "changes": {"K": 0.4, "K": 0.6}}',
        "the key 'K' is given twice; leave one",
    ),
    "unknown verb": (
        b'{"version": 1, "verb": "explode"}',
        "unknown verb 'explode'; known are broken, disarm, here, long, refused",
    ),
}


@pytest.mark.parametrize(("line", "message"), REFUSED.values(), ids=REFUSED)
def test_bad_request_is_answered_and_the_connection_goes_on(tmp_path, line, message):
    refused, after = answers(tmp_path / "s", [line, HERE])
    assert refused["error"].startswith(message)
    assert refused == {"version": 1, "ok": False, "error": refused["error"], "exit_code": 64}
    assert after == ECHO


def test_refusal_carries_the_exit_code(tmp_path):
    (refused,) = answers(tmp_path / "s", [b'{"version": 1, "verb": "refused"}'])
    assert refused == {"version": 1, "ok": False, "error": "refused: the state is OFF", "exit_code": 1}


def test_line_of_a_megabyte(tmp_path):
    """It is refused, in words, and that connection is closed; without the end of the line too."""

    async def conversation(reader, writer):
        writer.write(b"x" * 1_000_000)
        first = await reader.readline()
        try:
            rest = await reader.read()
        except ConnectionResetError:  # closed with the rest of the megabyte unread
            rest = b""
        return json.loads(first), rest

    refused, rest = talk(tmp_path / "s", conversation)
    assert refused["error"] == f"a request is at most {LIMIT} bytes long"
    assert refused["exit_code"] == 64
    assert rest == b""


def test_a_bug_in_a_verb_is_an_answer(tmp_path, capsys):
    broken, after = answers(tmp_path / "s", [b'{"version": 1, "verb": "broken"}', HERE])
    assert broken["exit_code"] == 70
    assert broken["error"].startswith("bug: ZeroDivisionError: float division by zero; ")
    assert after == ECHO
    assert "ZeroDivisionError" in capsys.readouterr().err


def mode_of(path, access=Access()):  # noqa: B008
    async def conversation(_reader, _writer):
        return path.stat()

    return talk(path, conversation, access)


def test_mode_and_group_as_configured(tmp_path):
    own = grp.getgrgid(os.getegid()).gr_name
    found = mode_of(tmp_path / "s", Access(own))
    assert stat.S_IMODE(found.st_mode) == 0o660
    assert found.st_gid == os.getegid()


def test_no_moment_in_which_others_may_connect(tmp_path, monkeypatch):
    """Between binding and the change of mode the socket is the owner's alone, whatever the umask."""
    seen = []
    chmod = Path.chmod
    monkeypatch.setattr(
        Path, "chmod", lambda path, mode: (seen.append(stat.S_IMODE(path.stat().st_mode)), chmod(path, mode))
    )
    before = os.umask(0)
    try:
        mode_of(tmp_path / "s")
        assert os.umask(0) == 0, "the umask is as it was"
    finally:
        os.umask(before)
    assert seen == [0o600]


def test_a_client_that_never_reads_is_dropped(tmp_path):
    """Its answers fill its buffer and wait for a moment; then it is cut off, and nobody else has waited."""
    path = tmp_path / "s"

    async def conversation(reader, writer):
        silent = socket.socket(socket.AF_UNIX)
        silent.connect(str(path))
        silent.setblocking(False)
        loop = asyncio.get_running_loop()
        with silent:
            with contextlib.suppress(ConnectionError, TimeoutError):
                async with asyncio.timeout(120):
                    while True:  # it asks until it is dropped
                        await loop.sock_sendall(silent, b'{"version": 1, "verb": "long"}\n' * 100)
                        writer.write(HERE + b"\n")
                        assert json.loads(await reader.readline()) == ECHO
            with contextlib.suppress(ConnectionError):
                taken = 0
                while chunk := await loop.sock_recv(silent, 1 << 20):
                    taken += len(chunk)
        writer.write(HERE + b"\n")
        return taken, json.loads(await reader.readline())

    taken, after = talk(path, conversation, bounds=Bounds(unread_s=0.2))
    assert after == ECHO
    assert taken < 5_000_000


def test_a_flood_cannot_starve_the_host(tmp_path):
    """While three clients send without a pause, other work of the same event loop gets its turn between any two
    answers."""
    path = tmp_path / "s"
    answered, most, last = 0, 0, 0

    async def count(_request):
        nonlocal answered
        answered += 1

    async def beat():
        nonlocal most, last
        while True:
            most, last = max(most, answered - last), answered
            await asyncio.sleep(0)

    async def main():
        served = ControlSocket(path, {"count": Verb(count, Right.OBSERVE)})
        await served.open()
        beating = asyncio.create_task(beat())
        clients = [await asyncio.open_unix_connection(str(path)) for _ in range(3)]
        try:
            for _, writer in clients:
                writer.write(b'{"version": 1, "verb": "count"}\n' * 2000)
            for reader, _ in clients:
                for _ in range(2000):
                    await reader.readline()
        finally:
            beating.cancel()
            for _, writer in clients:
                writer.close()
            served.close()

    asyncio.run(main())
    assert answered == 6000
    assert most <= 2


def dead_socket(path):
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    return path


def test_stale_socket_is_replaced(tmp_path):
    path = dead_socket(tmp_path / "s")
    claim(path)
    assert not path.exists()
    assert answers(dead_socket(path), [HERE]) == [ECHO]


def test_living_socket_is_not(tmp_path):
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as living:
        living.bind(str(path))
        living.listen()
        with pytest.raises(CheckFailed, match=f"another controller answers on {path}; stop it first"):
            claim(path)
        remove_stale(path)
        assert path.is_socket()


def test_one_that_lives_but_does_not_answer(tmp_path):
    """A stopped host with a full queue must neither lose its socket nor hold up the newcomer."""
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as living, socket.socket(socket.AF_UNIX) as waiting:
        living.bind(str(path))
        living.listen(0)
        waiting.connect(str(path))
        with pytest.raises(CheckFailed, match="another controller answers"):
            claim(path)
        assert path.is_socket()


@pytest.mark.parametrize("kind", ["file", "folder", "link to nothing"])
def test_what_is_no_socket_is_left_alone(tmp_path, kind):
    """``--socket config.yaml`` must not delete the configuration."""
    path = tmp_path / "cell.yaml"
    if kind == "file":
        path.write_text("precious")
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("nowhere")
    with pytest.raises(CheckFailed, match="is not a socket and stays as it is; choose another --socket"):
        claim(path)
    assert os.path.lexists(path)
    if kind == "file":
        assert path.read_text() == "precious"


@pytest.mark.parametrize(
    ("number", "kind", "advice"),
    [
        (errno.EACCES, PermissionDenied, "; choose another place, or have its rights changed"),
        (errno.ENOSPC, DeviceUnavailable, "; make room there, or choose another place"),
        (errno.EMFILE, DeviceUnavailable, ""),
    ],
)
def test_a_place_that_the_system_refuses(tmp_path, monkeypatch, number, kind, advice):
    """Another start may help where the machine lacks something, and systemd tries it after 69 only."""

    def refuse(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("micromanip.host.control.server.bound", refuse)
    path = tmp_path / "control.sock"
    with pytest.raises(kind) as told:
        talk(path, None)
    assert str(told.value) == f"no control socket at {path}: {os.strerror(number)}{advice}"


def request(verb):
    return json.dumps({"version": 1, "verb": verb}).encode() + b"\n"


class Crowd:
    """A served socket, whoever is to be at the other end, and what was refused."""

    def __init__(self, path, monkeypatch, **bounds):
        self.peers, self.told, self.joined = [], [], []
        own = Peer.of
        monkeypatch.setattr(Peer, "of", lambda connection: self.peers.pop(0) if self.peers else own(connection))
        self.served = ControlSocket(path, VERBS, bounds=Bounds(**bounds), refused=self._refused)

    async def _refused(self, peer, verb, why):
        self.told.append((peer.user, verb, why))

    async def join(self, peer=None):
        """A client; it has its slot when this returns."""
        self.peers += [] if peer is None else [peer]
        reader, writer = await asyncio.open_unix_connection(str(self.served.path))
        while peer is not None and self.peers:
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.001)
        self.joined.append((reader, writer))
        return reader, writer

    async def ask(self, client, verb):
        client[1].write(request(verb))
        return await self.hear(client)

    async def hear(self, client):
        line = await client[0].readline()
        return json.loads(line) if line else None

    def play(self, scene):
        async def main():
            await self.served.open()
            try:
                return await scene()
            finally:
                for _, writer in self.joined:
                    writer.transport.abort()
                self.served.close()
                await asyncio.sleep(0.01)

        return asyncio.run(main())


@pytest.fixture
def crowd(tmp_path, monkeypatch):
    return lambda **bounds: Crowd(tmp_path / "s", monkeypatch, **bounds)


@contextlib.contextmanager
def own_time():
    """The running loop's clock goes on by what its yield is awaited with: far more than the machine ever stalls."""
    loop = asyncio.get_running_loop()
    real, ahead_s = loop.time, 0.0

    async def pass_time(seconds):
        nonlocal ahead_s
        ahead_s += seconds
        for _ in range(10):  # whoever this wakes acts
            await asyncio.sleep(0)

    loop.time = lambda: real() + ahead_s
    try:
        yield pass_time
    finally:
        del loop.time


OPERATORS = frozenset({os.getegid()})
ANN, BEN = Peer("ann", 5001, 1, OPERATORS), Peer("ben", 5002, 2, OPERATORS)


def test_one_user_can_not_take_every_slot(crowd):
    """Idle clients of one user; another one is served, the first one's next is not, but for a stop."""
    hall = crowd(clients=8, of_a_user=4)

    async def scene():
        idle = [await hall.join(ANN) for _ in range(4)]
        ben = await hall.ask(await hall.join(BEN), "here")
        refused = await hall.ask(await hall.join(ANN), "here")
        stopped = await hall.ask(await hall.join(ANN), "disarm")
        idle[0][1].close()
        while (again := await hall.ask(await hall.join(ANN), "here")) == refused:
            await asyncio.sleep(0.01)
        return ben, refused, stopped, again

    ben, refused, stopped, again = hall.play(scene)
    assert ben == stopped == again == ECHO
    assert refused["error"] == "4 clients of ann are connected already; end one of them"
    assert refused["exit_code"] == 69
    assert set(hall.told) == {("ann", "connect", refused["error"])}


@pytest.mark.parametrize("same", [True, False])
def test_nobody_can_keep_others_from_stopping(crowd, same):
    """All slots are taken, and whoever took them sits in the reserved ones, too: a newcomer stops the cell."""
    hall = crowd(clients=4, of_a_user=3, reserved_s=30)

    async def scene():
        everybody = [await hall.join(peer) for peer in (ANN, ANN, ANN, BEN)]
        everybody += [await hall.join(ANN) for _ in range(5)]
        newcomer = ANN if same else Peer("cleo", 5003, 3, OPERATORS)
        stopped = await hall.ask(await hall.join(newcomer), "disarm")
        return stopped, await hall.hear(everybody[4]), await hall.ask(everybody[0], "here")

    stopped, evicted, before = hall.play(scene)
    assert stopped == ECHO
    assert evicted is None, "the one who waited longest in a reserved slot is closed"
    assert before == ECHO


def test_a_flood_of_the_one_does_not_evict_the_other_from_a_reserved_slot(crowd):
    hall = crowd(clients=4, of_a_user=4, reserved_s=30)

    async def scene():
        for _ in range(4):
            await hall.join(ANN)
        ben = await hall.join(BEN)  # and thinks for a while
        for _ in range(20):
            await hall.join(ANN)
        return await hall.ask(ben, "disarm")

    assert hall.play(scene) == ECHO


def test_a_reserved_slot_is_not_kept(crowd):
    """Who asks nothing is told why and closed; who has asked is closed, too."""
    hall = crowd(clients=1, of_a_user=1, reserved_s=300)

    async def scene():
        await hall.join(ANN)
        silent, stopping = await hall.join(BEN), await hall.join(BEN)
        await hall.ask(stopping, "disarm")
        with own_time() as pass_time:
            await pass_time(300)
        return await hall.hear(silent), await hall.hear(silent), await hall.hear(stopping)

    told, end, after = hall.play(scene)
    assert told["error"] == "1 clients are connected already; end one of them"
    assert end is None
    assert after is None


def test_idle_clients_are_closed_and_others_stay(crowd):
    """One that asks now and then is served for many times the idle time; half a line does not count as asking."""
    hall = crowd(idle_s=400)

    async def scene():
        idle, slow, regular = [await hall.join() for _ in range(3)]
        with own_time() as pass_time:
            for k in range(15):
                assert await hall.ask(regular, "here") == ECHO
                if k < 3:
                    slow[1].write(b"{")
                await pass_time(100)
        return [[await hall.hear(client), await hall.hear(client)] for client in (idle, slow)]

    for told, end in hall.play(scene):
        assert told == {"version": 1, "ok": False, "error": "closed: no request in 400 s", "exit_code": 69}
        assert end is None


def test_a_stop_does_not_wait_for_its_turn(tmp_path):
    """A hundred clients have each sent a request that takes a while: a stop comes before most of them."""
    path = tmp_path / "s"
    answered = 0

    async def slow(_request):
        nonlocal answered
        answered += 1
        time.sleep(0.005)  # as work that holds the event loop

    async def stop(_request):
        return answered

    async def main():
        verbs = {"slow": Verb(slow, Right.OBSERVE), "hold": Verb(stop, Right.OPERATE, stops=True)}
        served = ControlSocket(path, verbs)
        await served.open()
        clients = [await asyncio.open_unix_connection(str(path)) for _ in range(101)]
        try:
            for _, writer in clients[1:]:
                writer.write(request("slow") * 20)
            await asyncio.sleep(0.05)
            before = answered
            clients[0][1].write(request("hold"))
            return before, json.loads(await clients[0][0].readline())["result"]
        finally:
            for _, writer in clients:
                writer.transport.abort()
            served.close()

    before, at_the_stop = asyncio.run(main())
    assert at_the_stop - before < 20


OBSERVERS = 4_000_001
MAY = {
    "root": (Peer("root", 0, 1), {"observe", "operate"}),
    "the controller's user": (Peer("self", os.geteuid(), 1), {"observe", "operate"}),
    "an operator": (Peer("ann", 5001, 1, frozenset({7, 4_000_000})), {"observe", "operate"}),
    "an observer": (Peer("olga", 5002, 1, frozenset({7, OBSERVERS})), {"observe"}),
    "both": (Peer("bert", 5003, 1, frozenset({4_000_000, OBSERVERS})), {"observe", "operate"}),
    "nobody": (Peer("nobody", 65534, 1, frozenset({65534})), set()),
    "without numbers": (Peer("?"), set()),
}


@pytest.mark.parametrize(("peer", "rights"), MAY.values(), ids=MAY)
def test_who_may(peer, rights):
    authority = Authority(operators=4_000_000, observers=OBSERVERS)
    assert {right for right in Right if authority.allows(peer, right)} == rights


def test_a_verb_beyond_ones_rights_is_refused_and_told(crowd):
    hall = crowd()
    olga = Peer("olga", 5002, 7, frozenset({OBSERVERS}))

    async def scene():
        hall.served._authority = Authority(os.getegid(), OBSERVERS)
        client = await hall.join(olga)
        return [await hall.ask(client, verb) for verb in ("here", "disarm", "explode")]

    looked, refused, unknown = hall.play(scene)
    assert looked == ECHO
    assert refused["exit_code"] == 77
    assert refused["error"].startswith("disarm refused: olga may only observe; ")
    assert unknown["exit_code"] == 64
    assert [(user, verb) for user, verb, _ in hall.told] == [("olga", "disarm"), ("olga", "explode")]


def test_whatever_the_socket_refuses_is_told(crowd):
    hall = crowd()

    async def scene():
        client = await hall.join()
        client[1].write(b"arm!\n[1]\n" + request("here") + b"x" * 70_000 + b"\n")
        return [await hall.hear(client) for _ in range(4)]

    answered = hall.play(scene)
    assert [answer["ok"] for answer in answered] == [False, False, True, False]
    assert [verb for _, verb, _ in hall.told] == ["?", "?", "?"]
    assert [why for _, _, why in hall.told] == [answer["error"] for answer in answered if not answer["ok"]]


def entries_of(path):
    """The access control list as (tag, permissions, group)."""
    packed = os.getxattr(path, "system.posix_acl_access")
    return {entry[:2] + ((entry[2],) if entry[0] == 8 else ()) for entry in struct.iter_unpack("<HHI", packed[4:])}


def test_both_groups_are_let_in(tmp_path, monkeypatch):
    """Groups that the controller's user is not a member of, and which it can't give a file to."""
    monkeypatch.setattr(
        socket_file, "_group_id", lambda _, name: {"operators": 4_000_000, "observers": OBSERVERS}[name]
    )

    def refused(*_arguments):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "chown", refused)
    path = tmp_path / "s"
    access = Access(operate_group="operators", observe_group="observers")
    with bound(path, access)[0]:
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
        assert entries_of(path) == {(1, 6), (4, 0), (8, 6, 4_000_000), (8, 6, OBSERVERS), (16, 6), (32, 0)}
    path.unlink()
    with bound(path, Access(observe_group="observers"))[0]:
        assert entries_of(path) == {(1, 6), (4, 6), (8, 6, OBSERVERS), (16, 6), (32, 0)}


def test_a_socket_that_is_replaced_while_it_is_made(tmp_path, monkeypatch):
    """Somebody who may write in its folder puts a link there: what it leads to keeps its mode."""
    precious = tmp_path / "precious"
    precious.touch(0o600)
    path = tmp_path / "s"
    umask = os.umask

    def after_binding(mask):
        if path.is_socket():
            path.unlink()
            path.symlink_to(precious)
        return umask(mask)

    monkeypatch.setattr(os, "umask", after_binding)
    with pytest.raises(CheckFailed, match="was replaced while it was made"):
        bound(path, Access())
    assert stat.S_IMODE(precious.stat().st_mode) == 0o600


def test_a_client_that_was_closed_for_silence_comes_back(crowd):
    """A script that asks now and then does not notice; one whose controller has ended does."""
    hall = crowd(idle_s=0.1)

    async def scene():
        client = await asyncio.to_thread(Client, hall.served.path)
        before = await asyncio.to_thread(client.request, "here")
        await asyncio.sleep(0.3)
        after = await asyncio.to_thread(client.request, "here")
        hall.served.close()
        client.close()
        return before, after

    assert hall.play(scene) == ("here", "here")
