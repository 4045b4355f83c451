"""For a bus driver that is compiled, on a terminal or a TCP connection: its system calls, from compiled code."""

from micromanip.rt.io.sockets import ask, read_bytes, write_bytes
