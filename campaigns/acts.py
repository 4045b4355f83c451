"""What each kind of step does on the watched bench; a refusal is an answer, not an error."""

import json
import os
import signal
import socket
import time
from contextlib import suppress

from micromanip.errors import DeviceUnavailable, MicromanipError, UsageError

from .spoilt_files import garbage, spoil


def act(bench, step):
    """Do one step, without the pause after it."""
    bench.note(str(step))
    with suppress(ProcessLookupError):
        ACTS[step.kind](bench, **step.more)


def _asked(bench, verb, *arguments, **more):
    """Ask the controller; whether it accepted, None where that is not known."""
    try:
        with bench.client() as client:
            getattr(client, verb)(*arguments, **more)
    except (TimeoutError, DeviceUnavailable) as problem:
        bench.note(f"{verb}: {problem}")
        return None
    except (MicromanipError, UsageError) as problem:
        bench.note(f"{verb} refused: {str(problem)[:160]}")
        if "bug" in str(problem):
            bench.wrong("crash", f"{verb} {arguments}: {problem}")
        return False
    return True


def _arm(bench):
    asked_ns = time.monotonic_ns()
    if _asked(bench, "arm") is not False:
        bench.oracle.armed(asked_ns)


def _set(bench, changes):
    if _asked(bench, "set", changes):
        bench.set_in_force(changes)


def _reload(bench):
    text = bench.config.read_bytes()
    if _asked(bench, "reload"):
        bench.file_in_force(text)


def _hang_up(bench):
    """SIGHUP: as `reload`, but whether the file was taken over is not told."""
    if bench.alive:
        text = bench.config.read_bytes()
        os.kill(bench.running.process.pid, signal.SIGHUP)
        bench.file_in_force(text)


def _garbage(bench, seed):
    """Lines that are no requests, none of which may be accepted; `tests/host/test_garbage.py` has more of them."""
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(2.0)
        link.connect(str(bench.socket))
        answers = link.makefile("rb")
        for line in garbage(seed):
            link.sendall(line + b"\n")
            answer = answers.readline()
            if answer and json.loads(answer)["ok"]:
                bench.wrong("crash", f"garbage was accepted: {line[:200]!r}")


def _cut(bench, how, ms):
    bench.port.cut(how)
    bench.later(ms, bench.port.mend)


def _refuse(bench, ms):
    if bench.cell.blind:
        return
    bench.amplifier.refuses = True
    bench.later(ms, lambda: setattr(bench.amplifier, "refuses", False))


def _fail(bench, how, ms):
    bench.amplifier.fails = how
    bench.later(ms, lambda: setattr(bench.amplifier, "fails", None))


def _power(bench, ms):
    bench.amplifier.switch(False)
    bench.later(ms, lambda: bench.amplifier.switch(True))


def _rest(bench, how, reads):
    """Ask for rest, while readings fail: it must come, if the device could be written to all the time."""
    if not bench.alive:
        return
    bench.amplifier.fails = reads
    if how == "disarm":
        _asked(bench, "disarm")
    else:
        _stop(bench)
        if bench.running is not None and how == "park":
            bench.later(500, lambda: bench.park(5))
    bench.see_it_rest(f"{how} while readings are {reads}")
    bench.amplifier.fails = None


def _kill(bench, who):
    names = {"host and loop": ("host", "loop"), "all": ("host", "loop", "worker")}.get(who, (who,))
    for pid in [pid for name in names if (pid := bench.process(name)) is not None]:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _stop(bench):
    if bench.alive:
        bench.running.process.send_signal(signal.SIGTERM)


ACTS = {
    "arm": _arm,
    "set": _set,
    "bad set": _set,
    "reload": _reload,
    "hang up": _hang_up,
    "garbage": _garbage,
    "cut": _cut,
    "refuse": _refuse,
    "reads fail": _fail,
    "power": _power,
    "rest": _rest,
    "kill": _kill,
    "stop": _stop,
    "spoil": lambda bench, how: bench.config.write_bytes(spoil(bench.text, how)),
    "repair": lambda bench: bench.config.write_text(bench.text),
    "freeze": lambda bench, who, ms: bench.freeze(who, ms),
    "jog": lambda bench, axis, **where: _asked(bench, "jog", axis, **where),
    "park": lambda bench, wait_s: bench.park(wait_s),
    "start": lambda bench: bench.start(),
    **{verb: lambda bench, verb=verb: _asked(bench, verb) for verb in ("disarm", "hold", "reset")},
}
