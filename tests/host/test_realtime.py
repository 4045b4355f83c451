"""What the loop process has in memory when it runs, and what it lets go of before."""

import ctypes
import mmap
from pathlib import Path

from micromanip.host.realtime import clean_code


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
