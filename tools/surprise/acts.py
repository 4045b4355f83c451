"""What each kind of step does in the yard; a refusal is an answer, not an error."""

import json
import os
import signal
import socket
import time
from contextlib import suppress

from micromanip.errors import DeviceUnavailable, MicromanipError, UsageError
from tools.garbage import lines

from .spoilt_files import spoil

_LINES = 20


def act(yard, step):
    """Do one step, without the pause after it."""
    yard.note(str(step))
    with suppress(ProcessLookupError):
        ACTS[step.kind](yard, **step.more)


def _asked(yard, verb, *arguments, **more):
    """Ask the controller; whether it accepted, None where that is not known."""
    try:
        with yard.client() as client:
            getattr(client, verb)(*arguments, **more)
    except (TimeoutError, DeviceUnavailable) as problem:
        yard.note(f"{verb}: {problem}")
        return None
    except (MicromanipError, UsageError) as problem:
        yard.note(f"{verb} refused: {str(problem)[:160]}")
        if "bug" in str(problem):
            yard.wrong("crash", f"{verb} {arguments}: {problem}")
        return False
    return True


def _arm(yard):
    asked_ns = time.monotonic_ns()
    if _asked(yard, "arm") is not False:
        yard.referee.armed(asked_ns)


def _set(yard, changes):
    if _asked(yard, "set", changes):
        yard.set_in_force(changes)


def _reload(yard):
    text = yard.config.read_bytes()
    if _asked(yard, "reload"):
        yard.file_in_force(text)


def _hang_up(yard):
    """SIGHUP: as `reload`, but whether the file was taken over is not told."""
    if yard.alive:
        text = yard.config.read_bytes()
        os.kill(yard.running.process.pid, signal.SIGHUP)
        yard.file_in_force(text)


def _garbage(yard, seed):
    """Lines that are no requests, none of which may be accepted."""
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(2.0)
        link.connect(str(yard.socket))
        answers = link.makefile("rb")
        for line in lines(seed, _LINES):
            link.sendall(line + b"\n")
            answer = answers.readline()
            if answer and json.loads(answer)["ok"]:
                yard.wrong("crash", f"garbage was accepted: {line[:200]!r}")


def _cut(yard, how, ms):
    yard.wire.cut(how)
    yard.later(ms, yard.wire.mend)


def _refuse(yard, ms):
    with suppress(AssertionError):
        yard.device.order(**yard.cell.refusal, for_s=ms * 1e-3)


def _kill(yard, who):
    names = {"host and loop": ("host", "loop"), "all": ("host", "loop", "worker")}.get(who, (who,))
    for pid in [pid for name in names if (pid := yard.process(name)) is not None]:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _stop(yard):
    if yard.alive:
        yard.running.process.send_signal(signal.SIGTERM)


ACTS = {
    "arm": _arm,
    "set": _set,
    "bad set": _set,
    "reload": _reload,
    "hang up": _hang_up,
    "garbage": _garbage,
    "cut": _cut,
    "refuse": _refuse,
    "kill": _kill,
    "stop": _stop,
    "spoil": lambda yard, how: yard.config.write_bytes(spoil(yard.text, how)),
    "repair": lambda yard: yard.config.write_text(yard.text),
    "freeze": lambda yard, who, ms: yard.freeze(who, ms),
    "jog": lambda yard, axis, **where: _asked(yard, "jog", axis, **where),
    "safe-outputs": lambda yard, wait_s: yard.safe_outputs(wait_s),
    "start": lambda yard: yard.start(),
    **{verb: lambda yard, verb=verb: _asked(yard, verb) for verb in ("disarm", "hold", "reset")},
}
