"""What a stranger on the same machine has put where the program looks: it is told, and nothing is asked or loaded."""

import multiprocessing
import os
import socket
import tempfile
from pathlib import Path

import pytest

from micromanip.client import Client
from micromanip.errors import PermissionDenied
from micromanip.files import own_temporary_folder
from micromanip.host.state_directory import state_directory

STRANGER = 4711

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can play another user")


def serve(path, uid, ready, asked):
    os.setuid(uid)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()
        ready.set()
        connection, _ = server.accept()
        asked.send(connection.recv(1000))


@pytest.fixture
def server():
    """Starts a server at a path, as a user; what it hears comes out of the pipe."""
    spawn, started = multiprocessing.get_context("fork"), []

    def start(path, uid):
        ready, (heard, asked) = spawn.Event(), spawn.Pipe(duplex=False)
        process = spawn.Process(target=serve, args=(path, uid, ready, asked))
        process.start()
        started.append(process)
        assert ready.wait(20)
        return heard

    yield start
    for process in started:
        process.kill()
        process.join()


@pytest.fixture(params=[None, "/run"])
def folder(request):
    """In the temporary folder, where anybody can have made it; below root's, where only root can."""
    with tempfile.TemporaryDirectory(dir=request.param) as name:
        yield Path(name)


def test_a_strangers_socket_is_not_asked(server, folder):
    os.chown(folder, STRANGER, STRANGER)
    heard = server(folder / "control.sock", STRANGER)
    if folder.parent == Path("/run"):
        Client(folder / "control.sock").close()
        return
    with pytest.raises(PermissionDenied, match=f"belongs to user {STRANGER}"):
        Client(folder / "control.sock")
    assert heard.poll(20)
    assert heard.recv() == b""


def test_a_stranger_in_a_folder_that_is_not_his_is_not_asked(server, folder):
    folder.chmod(0o1777)
    server(folder / "control.sock", STRANGER)
    with pytest.raises(PermissionDenied, match=f"belongs to user {STRANGER}"):
        Client(folder / "control.sock")


def test_a_temporary_folder_of_somebody_else_is_not_ours(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError))
    for name in ("XDG_STATE_HOME", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    folder = own_temporary_folder()
    assert (state_directory().parent, folder.stat().st_mode & 0o777) == (folder, 0o700)
    for spoil in (
        lambda: os.chown(folder, STRANGER, STRANGER),
        lambda: folder.chmod(0o777),
        lambda: (folder.rmdir(), folder.symlink_to(tmp_path)),
    ):
        spoil()
        with pytest.raises(PermissionDenied, match="nothing in it can be believed"):
            state_directory()
        if not folder.is_symlink():
            os.chown(folder, 0, 0)
