"""The control socket takes anything from anybody, and answers each line on its own."""

import asyncio
import json
import os
import socket
import stat
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from micromanip.errors import CheckFailed, UsageError
from micromanip.host.control_socket import ControlSocket, claim, remove_stale

LIMIT = 65536
ECHO = {"version": 1, "ok": True, "result": "here"}


async def _here(_request):
    return "here"


async def _refused(_request):
    raise CheckFailed("refused: the state is OFF")


def talk(path, conversation):
    """Serve, run `conversation(reader, writer)` against it, close."""

    async def main():
        served = ControlSocket(path, {"here": _here, "refused": _refused})
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
    "number too long": (b'{"version": ' + b"1" * 5000 + b"}", "not a line of JSON: "),
    "not an object": (b"[1]", 'a request is a JSON object with "version": 1'),
    "no version": (b'{"verb": "here"}', 'a request is a JSON object with "version": 1'),
    "wrong version": (b'{"version": 2, "verb": "here"}', 'a request is a JSON object with "version": 1'),
    "version as text": (b'{"version": "1", "verb": "here"}', 'a request is a JSON object with "version": 1'),
    "unknown verb": (b'{"version": 1, "verb": "explode"}', "unknown verb 'explode'; known are here, refused"),
    "no verb": (b'{"version": 1}', "unknown verb None; known are here, refused"),
    "verb is a list": (b'{"version": 1, "verb": ["here"]}', "unknown verb ['here']; known are here, refused"),
    "half a character": (b'{"version": 1, "verb": "\\ud800"}', "unknown verb '\\ud800'; known are here, refused"),
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


def test_only_owner_and_group_may_connect(tmp_path):
    path = tmp_path / "deep" / "er" / "s"

    async def conversation(_reader, _writer):
        return stat.S_IMODE(path.stat().st_mode)

    assert talk(path, conversation) == 0o660
    assert not path.exists()


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
