"""Files are written whole, through nobody's link, and whatever is put in their place meanwhile."""

import os
import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip import files
from micromanip.files import HeldFolder, held, linked_file

STRANGER = 4_000_000


def others(path):
    """`path` belongs to somebody else."""
    os.chown(path, STRANGER, STRANGER, follow_symlinks=False)
    return path


root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to others")


def test_written_whole_and_nothing_is_left_beside_it(tmp_path):
    with HeldFolder(tmp_path / "deep" / "er", make=True) as folder:
        folder.write("cell.yaml", b"one", 0o640)
        folder.write("cell.yaml", b"two")
        assert folder.read("cell.yaml") == b"two"
    (file,) = (tmp_path / "deep" / "er").iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    assert stat.S_IMODE((tmp_path / "deep").stat().st_mode) == 0o755


def test_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch):
    (tmp_path / "cell.yaml").write_text("before")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with HeldFolder(tmp_path) as folder, pytest.raises(OSError, match="No space left"):
        folder.write("cell.yaml", b"after")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("cell.yaml", "before")]


def test_file_and_folder_are_synchronised(tmp_path, monkeypatch):
    kinds = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: kinds.append(stat.S_IFMT(os.fstat(descriptor).st_mode)))
    with HeldFolder(tmp_path) as folder:
        folder.write("cell.yaml", b"")
    assert kinds == [stat.S_IFREG, stat.S_IFDIR]


def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("precious")
    (tmp_path / "cell.yaml").symlink_to(precious)
    with HeldFolder(tmp_path) as folder:
        assert folder.read("cell.yaml") is None
        folder.write("cell.yaml", b"new", 0o644)
    assert precious.read_text() == "precious"
    assert not (tmp_path / "cell.yaml").is_symlink()


def test_a_fifo_is_no_file_and_does_not_hold_up(tmp_path):
    os.mkfifo(tmp_path / "cell.yaml")
    with HeldFolder(tmp_path) as folder:
        assert folder.read("cell.yaml") is None


def test_the_folder_stays_the_same_one_while_it_is_held(tmp_path):
    """Its name is taken by a link while something is written: the file lies in the folder that was meant."""
    meant, elsewhere = tmp_path / "meant", tmp_path / "elsewhere"
    meant.mkdir()
    elsewhere.mkdir()
    with HeldFolder(meant) as folder:
        meant.rename(tmp_path / "moved")
        meant.symlink_to(elsewhere)
        folder.write("cell.yaml", b"new")
    assert list(elsewhere.iterdir()) == []
    assert (tmp_path / "moved" / "cell.yaml").read_bytes() == b"new"


def test_removing_follows_nothing(tmp_path):
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "file").write_text("precious")
    doomed = tmp_path / "doomed"
    doomed.mkdir()
    (doomed / "link").symlink_to(precious)
    (tmp_path / "link").symlink_to(precious)
    with HeldFolder(tmp_path) as folder:
        for name in ("doomed", "link", "never was"):
            folder.remove(name)
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]
    assert (precious / "file").read_text() == "precious"


def test_strict_takes_no_link_at_all(tmp_path):
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc" / "micromanip").symlink_to(tmp_path)
    with pytest.raises(PermissionError, match="micromanip is a link that may lead anywhere"):
        HeldFolder(tmp_path / "etc" / "micromanip", below=tmp_path)
    with HeldFolder(tmp_path / "etc" / "micromanip") as folder:  # one's own is followed otherwise
        folder.write("file", b"")
    assert (tmp_path / "file").exists()


@root_only
def test_root_follows_no_link_of_somebody_else(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    with HeldFolder(tmp_path / "link") as folder:
        folder.write("mine", b"")
    others(tmp_path / "link")
    with pytest.raises(PermissionError, match="link is a link"):
        HeldFolder(tmp_path / "link")


@root_only
@pytest.mark.parametrize("spoil", ["owned by a stranger", "group may write", "anybody may write"])
def test_strict_wants_every_folder_on_the_way_safe(tmp_path, spoil):
    folder = tmp_path / "etc" / "units"
    folder.mkdir(parents=True)
    if spoil == "owned by a stranger":
        others(tmp_path / "etc")
    else:
        (tmp_path / "etc").chmod(0o775 if spoil == "group may write" else 0o757)
    with pytest.raises(PermissionError, match="the folder that units is in is not safe"):
        HeldFolder(folder, below=tmp_path)
    (tmp_path / "etc").chmod(0o1777)
    if spoil != "owned by a stranger":
        HeldFolder(folder, below=tmp_path).__exit__(None, None, None)
    (tmp_path / "etc").chmod(0o755)
    os.chown(tmp_path / "etc", 0, 0)
    folder.chmod(0o2770)  # the last may be open to others
    with HeldFolder(folder, below=tmp_path) as last:
        last.write("file", b"")
    others(folder)
    with pytest.raises(PermissionError, match="the folder is not safe"):
        HeldFolder(folder, below=tmp_path)


@root_only
def test_the_file_before_keeps_its_owner(tmp_path):
    (tmp_path / "cell.yaml").write_text("before")
    others(tmp_path / "cell.yaml")
    with HeldFolder(tmp_path) as folder:
        folder.write("cell.yaml", b"after")
    assert (tmp_path / "cell.yaml").stat().st_uid == STRANGER


def test_own_links_to_a_file_are_followed(tmp_path):
    (tmp_path / "one").symlink_to("two")
    (tmp_path / "two").symlink_to(tmp_path / "three")
    assert linked_file(tmp_path / "one") == tmp_path / "three"
    (tmp_path / "loop").symlink_to("loop")
    assert linked_file(tmp_path / "loop").name == "loop"


@root_only
def test_links_of_others_to_a_file_are_not(tmp_path):
    (tmp_path / "one").symlink_to("two")
    others(tmp_path / "one")
    assert linked_file(tmp_path / "one") == tmp_path / "one"


NAMES = st.sampled_from(["a", "b", "c"])


@given(st.lists(st.tuples(NAMES, NAMES, st.booleans()), max_size=6), st.lists(NAMES, min_size=1, max_size=4))
def test_walks_as_the_kernel_does(tmp_path_factory, made, wanted):
    """Folders and own links in any arrangement, loops too: where the kernel gets to, or nowhere."""
    top = tmp_path_factory.mktemp("walk")
    places = [top]
    for k, (name, target, is_link) in enumerate(made):
        here = places[k % len(places)] / name
        if here.is_symlink() or here.exists():
            continue
        if is_link:
            here.symlink_to(Path("..") / target if k % 2 else target)
        else:
            here.mkdir()
            places.append(here)
    path = top.joinpath(*wanted)
    reached = path.is_dir()
    try:
        with HeldFolder(path) as folder:
            assert os.path.samestat(os.fstat(folder._descriptor), path.stat())
            assert reached
    except OSError:
        assert not reached


def test_names_are_new_each_time(tmp_path, monkeypatch):
    """What lies under the name of the part already is neither followed nor overwritten."""
    (tmp_path / "precious").write_text("precious")
    monkeypatch.setattr(files.secrets, "token_hex", lambda _: "known")
    (tmp_path / ".cell.yaml.known.part").symlink_to("precious")
    with held(tmp_path / "cell.yaml") as (folder, name), pytest.raises(FileExistsError):
        folder.write(name, b"new")
    assert (tmp_path / "precious").read_text() == "precious"
