"""What the loop process has in memory when it runs, and what it lets go of before."""

import ctypes
import mmap
from pathlib import Path

from micromanip.host.realtime import clean_code

SMAPS = """\
7f1000000000-7f1000200000 r-xp 00000000 fe:00 7 /site/llvmlite/binding/libllvmlite.so
Size:               2048 kB
Private_Dirty:         0 kB
Anonymous:             0 kB
7f1000200000-7f1000300000 r--p 00200000 fe:00 7 /site/llvmlite/binding/libllvmlite.so
Private_Dirty:       880 kB
Anonymous:           880 kB
7f1000300000-7f1000400000 rw-p 00300000 fe:00 7 /site/llvmlite/binding/libllvmlite.so
Private_Dirty:         0 kB
Anonymous:             0 kB
7f1000400000-7f1000500000 r-xp 00000000 fe:00 8 /usr/lib/libc.so.6
Private_Dirty:         0 kB
Anonymous:             0 kB
7f1000500000-7f1000600000 rw-p 00000000 00:00 0
Private_Dirty:         0 kB
Anonymous:             0 kB
"""


def test_relocated_tables_stay():
    """They are read-only like code, and would come back with the addresses that they had before they were loaded."""
    assert clean_code("llvmlite", SMAPS) == [(0x7F1000000000, 0x7F1000200000)]


def test_what_was_written_to_is_known_to_this_kernel(tmp_path):
    file = tmp_path / "library"
    file.write_bytes(bytes(2 * mmap.PAGESIZE))
    with file.open("rb") as opened:
        mapped = mmap.mmap(opened.fileno(), 0, flags=mmap.MAP_PRIVATE, prot=mmap.PROT_READ | mmap.PROT_WRITE)
    first = ctypes.addressof(ctypes.c_char.from_buffer(mapped))
    protect = ctypes.CDLL(None).mprotect
    assert protect(ctypes.c_void_p(first), ctypes.c_size_t(len(mapped)), mmap.PROT_READ) == 0
    assert clean_code(str(file), Path("/proc/self/smaps").read_text()) == [(first, first + len(mapped))]
    assert protect(ctypes.c_void_p(first), ctypes.c_size_t(len(mapped)), mmap.PROT_READ | mmap.PROT_WRITE) == 0
    mapped[5] = 1
    assert protect(ctypes.c_void_p(first), ctypes.c_size_t(len(mapped)), mmap.PROT_READ) == 0
    assert clean_code(str(file), Path("/proc/self/smaps").read_text()) == []
