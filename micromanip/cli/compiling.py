"""Lines for people while the laws are compiled: once after an update, and for some ten seconds."""

from __future__ import annotations

from collections.abc import Callable

from .echo import echo


def show_compiling(show: Callable[[str], None] = lambda line: echo(line, err=True)) -> None:
    """Let `show` have what is compiled in this process from now on, and how long it will take."""
    from micromanip.rt.jit import Compiler

    Compiler.tell = staticmethod(lambda name: show(f"compiling {name} for this processor, once after an update"))
    Compiler.tell_left = staticmethod(lambda name, seconds: show(f"compiling {name}: {seconds:.0f} s left"))
