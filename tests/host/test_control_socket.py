"""The control socket takes anything from anybody, and answers each line on its own."""

import asyncio
import contextlib
import grp
import json
import os
import socket
import stat
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from micromanip.errors import CheckFailed, UsageError
from micromanip.host.control_socket import Access, Bounds, ControlSocket, claim, remove_stale

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


VERBS = {"here": _here, "refused": _refused, "broken": _broken, "long": _long}


def talk(path, conversation, access=Access(), bounds=Bounds()):  # noqa: B008
    """Serve, run `conversation(reader, writer)` against it, close."""

    async def main():
        served = ControlSocket(path, VERBS, access, bounds)
        await served.open()
        try:
            reader, writer = await asyncio.open_unix_connection(str(path), limit=1 << 22)
            try:
                return await asyncio.wait_for(conversation(reader, writer), 30)
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


def test_good_request(tmp_path):
    assert answers(tmp_path / "s", [HERE]) == [ECHO]


REFUSED = {
    "not JSON": (b"arm!", "not a line of JSON: Expecting value"),
    "empty line": (b"", "not a line of JSON: Expecting value"),
    "half a line": (b'{"version": 1, "verb"', "not a line of JSON: Expecting ':'"),
    "not text": (b"\xff\xfe\x00", "not a line of JSON: "),
    "nested without end": (b"[" * 60_000, "not a line of JSON: "),
    "nested deeply": (b'{"version": 1, "verb": "here", "x": ' + b"[" * 33 + b"]" * 33 + b"}", "a request is nested at"),
    "number too long": (b'{"version": ' + b"1" * 5000 + b"}", "not a line of JSON: "),
    "not an object": (b"[1]", 'a request is a JSON object with "version": 1'),
    "no version": (b'{"verb": "here"}', 'a request is a JSON object with "version": 1'),
    "wrong version": (b'{"version": 2, "verb": "here"}', "version 2 of the protocol is not supported; supported is 1"),
    "version as text": (b'{"version": "1", "verb": "here"}', "version '1' of the protocol is not supported"),
    "version true": (b'{"version": true, "verb": "here"}', "version True of the protocol is not supported"),
    "not a number": (
        b'{"version": 1, "verb": "here", "x": NaN}',
        "expected finite numbers, not NaN; where no limit is meant",
    ),
    "unknown verb": (
        b'{"version": 1, "verb": "explode"}',
        "unknown verb 'explode'; known are broken, here, long, refused",
    ),
    "no verb": (b'{"version": 1}', "a verb is a text, not None"),
    "verb is a list": (b'{"version": 1, "verb": ["here"]}', "a verb is a text, not ['here']"),
    "half a character": (
        b'{"version": 1, "verb": "\\ud800"}',
        "unknown verb '\\ud800'; known are broken, here, long, refused",
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


@given(st.binary(max_size=300))
@example(b"\0\n\0\n\0")
@example(b'{"version": 1, "verb": NaN}')
def test_random_bytes(tmp_path_factory, noise):
    """Each line of whatever is sent gets one JSON answer, then a good request a good one."""

    async def conversation(reader, writer):
        writer.write(noise + b"\n" + HERE + b"\n")
        return [json.loads(await reader.readline()) for _ in range(noise.count(b"\n") + 2)]

    heard = talk(tmp_path_factory.mktemp("noise") / "s", conversation)
    assert all(not answer["ok"] and answer["exit_code"] == 64 for answer in heard[:-1])
    assert heard[-1] == ECHO


def test_request_in_pieces(tmp_path):
    async def conversation(reader, writer):
        for k in range(len(HERE)):
            writer.write(HERE[k : k + 1])
            await writer.drain()
        writer.write(b"\n")
        return json.loads(await reader.readline())

    assert talk(tmp_path / "s", conversation) == ECHO


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


def test_last_line_without_its_end(tmp_path):
    async def conversation(reader, writer):
        writer.write(HERE)
        writer.write_eof()
        return json.loads(await reader.readline())

    assert talk(tmp_path / "s", conversation) == ECHO


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


def test_only_owner_and_group_may_connect(tmp_path):
    path = tmp_path / "deep" / "er" / "s"
    assert stat.S_IMODE(mode_of(path).st_mode) == 0o660
    assert not path.exists()


def test_mode_and_group_as_configured(tmp_path):
    own = grp.getgrgid(os.getegid()).gr_name
    found = mode_of(tmp_path / "s", Access(0o600, own))
    assert stat.S_IMODE(found.st_mode) == 0o600
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


def test_unknown_group(tmp_path):
    message = "control.group: there is no group nobodys-own on this machine; `groupadd nobodys-own` makes it"
    with pytest.raises(UsageError, match=f"^{message}$"):
        mode_of(tmp_path / "s", Access(0o660, "nobodys-own"))
    assert not (tmp_path / "s").exists()


def test_too_many_clients(tmp_path):
    path = tmp_path / "s"

    async def conversation(reader, writer):
        async def heard(reader):
            return json.loads(await reader.readline())

        second, third = [await asyncio.open_unix_connection(str(path)) for _ in range(2)]
        told = await heard(third[0]), await third[0].read()
        for _, other in (second, third):
            other.close()
        writer.write(HERE + b"\n")
        first = await heard(reader)
        fourth = await asyncio.open_unix_connection(str(path))  # there is room again
        fourth[1].write(HERE + b"\n")
        again = await heard(fourth[0])
        fourth[1].close()
        return told, first, again

    (told, end), first, again = talk(path, conversation, bounds=Bounds(clients=2))
    assert told == {
        "version": 1,
        "ok": False,
        "error": "2 clients are connected already; end one of them",
        "exit_code": 69,
    }
    assert end == b""
    assert first == again == ECHO


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
                async with asyncio.timeout(20):
                    while True:  # it asks until it is dropped
                        await loop.sock_sendall(silent, b'{"version": 1, "verb": "long"}\n' * 100)
                        writer.write(HERE + b"\n")
                        assert json.loads(await reader.readline()) == ECHO
                    raise AssertionError
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
        served = ControlSocket(path, {"count": count})
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


@pytest.mark.parametrize("path", ["/proc/none/control.sock", f"/tmp/{'x' * 120}", "/dev/null/control.sock"])
def test_impossible_place(path):

    with pytest.raises(UsageError, match=r"no control socket at .*; choose another --socket"):
        talk(Path(path), None)
