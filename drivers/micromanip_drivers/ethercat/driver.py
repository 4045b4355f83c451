"""The driver ``ethercat``: a line of terminals whose process data the loop itself exchanges; see docs/ethercat.md."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from micromanip.driver import Answer, BusError, Channel, ConfigError, Functions, Load, real_because
from micromanip.driver.ethercat import INIT, OP, STATE_MASK, registers
from micromanip.driver.wire import MOST_BITS, LoopWire, lend, set_lock

from .bring_up import bring_to_safeop
from .esi_check import compare_with_file
from .image import Image
from .line_supervisor import LineSupervisor
from .link import LOOP_SENDERS, Link, open_interface
from .options import EthercatOptions
from .records import BAD, CONTEXT, WHOLE
from .scan import differences, found

_WIRE_BYTES = 24
"""Of each frame besides its own: preamble, checksum, gap."""
_BIT_S = 1e-8
"""EtherCAT has 100 Mbit/s."""
_COUNTS = 1 << 32


class Ethercat(LoopWire):
    """The master of a line of terminals."""

    Options: ClassVar[type[BaseModel]] = EthercatOptions
    CONTEXT, COUNTERS, BAD = CONTEXT, ("received", "delayed", *BAD, "bring_ups"), BAD
    options: EthercatOptions

    def __init__(self, options: EthercatOptions, period_ns: int) -> None:
        super().__init__(options, period_ns, options.outputs, "terminals")
        self._image = Image(options)
        _require_own_names(options)
        if options.outputs:
            options.must_last("", 1e9 / period_ns)
        for name, terminal in options.terminals.items():
            if terminal.sync0_shift_us is not None and terminal.sync0_shift_us * 1e3 >= period_ns:
                raise ConfigError(
                    f"terminals.{name}.sync0_shift_us: {terminal.sync0_shift_us:g} us must be less than the cycle of "
                    f"{1e-3 * period_ns:g} us"
                )
        self._tables = self._image.received(), self._image.sent()
        if self._wire_s > 1e-9 * period_ns:
            raise ConfigError(
                f"terminals: a frame of {len(self._image.frame)} bytes takes {1e6 * self._wire_s:.0f} us on the wire, "
                f"longer than the cycle of {1e-3 * period_ns:g} us"
            )

    @property
    def files(self) -> tuple[Path, ...]:
        return tuple(Path(terminal.esi) for terminal in self.options.terminals.values() if terminal.esi is not None)

    def check_files(self, folder: Path) -> None:
        for name, terminal in self.options.terminals.items():
            compare_with_file(name, terminal, folder)

    @property
    def device(self) -> str:
        return self.devices[0]

    @property
    def devices(self) -> tuple[str, ...]:
        return tuple(f"ethercat {interface}" for interface in self.options.interfaces)

    @property
    def real_because(self) -> str | None:
        found = (real_because(each) for each in self.devices)
        return next((reason for reason in found if reason is not None), None)

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(self._image.inputs)

    @property
    def slow_inputs(self) -> tuple[Channel, ...]:
        period_s, age_s = self.period_ns * 1e-9, self.age_s
        rates: dict[str, tuple[float, float]] = {}
        for terminal in self.options.terminals.values():
            for pdo in terminal.inputs.values():
                rate_hz = 1 / period_s if pdo.rate_hz is None else pdo.rate_hz
                rates |= dict.fromkeys(pdo.fields, (rate_hz, age_s + pdo.latency_us * 1e-6))
        return tuple(Channel(name, *rates[name]) for name in self.inputs)

    def loads(self) -> Sequence[Load]:
        """The line is a ring: a frame is on it once, both ways at the same time."""
        rate_hz, length = 1e9 / self.period_ns, len(self._image.frame)
        what = f"{rate_hz:g} x {1e6 * self._wire_s:.3g} us, {length} bytes, {len(self.options.terminals)} terminals"
        return [Load("line", rate_hz * self._wire_s, what)]

    @property
    def _wire_s(self) -> float:
        return 8 * (len(self._image.frame) + _WIRE_BYTES) * _BIT_S

    def fill(self, c: Any) -> None:
        image = self._image
        c["receive"], c["send"] = self._tables[0][0], self._tables[1][0]
        c["terminals"], c["working_counter"] = len(self.options.terminals), image.working_counter
        c["working_counter_at"], c["status_at"] = image.image_at + image.bytes, image.status_at
        c["counts"] = c["counted"]["counts"] = _COUNTS
        c["clock"]["unit_ns"], c["clock"]["bits"] = 1.0, MOST_BITS
        c["time_at"], lock = image.time_at, self.options.lock
        ring = c["ring"]
        ring["present"], ring["cut_behind"], ring["half"]["count"] = len(self.options.interfaces) - 1, WHOLE, -1
        ring["socket"]["descriptor"] = -1
        ring["position_at"], ring["inputs_at"][: len(image.inputs_at)] = image.position_at, image.inputs_at
        ring["clock_position_at"] = image.clock_position_at if self.options.clocks else 0
        if lock is not None:
            set_lock(c["lock"], self.period_ns, 1e-3 * lock.time_constant_ms, lock.drift_ppm, lock.within_us)

    @property
    def steers(self) -> bool:
        return self.options.lock is not None

    def steering_ns(self, context: NDArray[np.uint8]) -> NDArray[np.int64]:
        found: NDArray[np.int64] = self.record(context)["lock"]["step_ns"]
        return found

    def statistics(self, context: NDArray[np.uint8]) -> Mapping[str, int]:
        """With `lock` also where it stands: error of the deadlines, rms over a second, and the clock's drift.

        Of a ring how often it was cut, and where it is.
        """
        c = self.record(context)
        counts, lock, ring = super().statistics(context), c["lock"], c["ring"]
        if ring["present"]:
            counts = {**counts, "cuts": int(ring["cuts"])}
            if ring["cut_behind"] != WHOLE:
                counts["cut_behind"] = int(ring["cut_behind"])
        if not lock["present"]:
            return counts
        drift_ppb, rms_ns = 1e9 * lock["gained_ns"] / self.period_ns, math.sqrt(lock["square_ns2"])
        return {
            **counts,
            **{name: int(lock[name]) for name in ("locked", "unlocked")},
            "clock_leaps": int(lock["steps"]),
            "clock_drift_ppb": round(drift_ppb),
            "deadline_error_rms_ns": round(rms_ns),
        }

    def begin(self, context: NDArray[np.uint8]) -> None:
        """Slaves that somebody left operating come to rest by INIT, in which nothing is put out."""
        c = self.record(context)
        with Link(*self.options.interfaces) as link:
            clocks = bring_to_safeop(link, self.options, self._image, self.period_ns)
        if self.options.watchdog is not None:
            time.sleep(self.options.watchdog.rest_ms * 1e-3)
        sockets = c["socket"], c["ring"]["socket"]
        for interface, sender, record in zip(self.options.interfaces, LOOP_SENDERS, sockets, strict=False):
            lend(open_interface(interface, sender).detach(), record)
        LineSupervisor(self.options, self._image, c, self.period_ns, clocks).start()

    def functions(self) -> Functions:
        from . import exchange  # compiled: loaded only where it is going to be called

        return Functions(*exchange.ENTRIES.addresses)

    def probe(self, seconds: float) -> Iterator[Answer]:  # noqa: ARG002 (it is asked once)
        """Who is on the line, by the EEPROMs; station addresses are given, states and outputs stay."""
        terminals = list(self.options.terminals.items())
        with Link(*self.options.interfaces) as link:
            for place, slave in enumerate(found(link)):
                note = "not configured"
                if place < len(terminals):
                    name, terminal = terminals[place]
                    note = "; ".join(differences(slave, terminal)) or name
                numbers = {key: f"0x{value:08x}" for key, value in slave.identity.items()}
                yield Answer(f"{self.device} slave {place + 1}", numbers, note)

    def is_at_rest(self) -> bool:
        """Whether all terminals are there, and none operates."""
        try:
            with Link(*self.options.interfaces) as link:
                link.write(registers.BWR, 0, registers.AL_CONTROL, struct.pack("<H", INIT))
                back = link.read(registers.BRD, 0, registers.AL_STATUS, 2)
        except BusError:
            return False
        (status,) = struct.unpack("<H", back.data)
        return back.wkc == len(self.options.terminals) and not status & STATE_MASK & OP


def _require_own_names(options: EthercatOptions) -> None:
    """Raises ConfigError for two fields of one name and direction."""
    for direction in ("outputs", "inputs"):
        seen: dict[str, str] = {}
        for terminal, keys in options.terminals.items():
            for pdo in getattr(keys, direction).values():
                for name in (name for name, field in pdo.fields.items() if field.is_channel):
                    if name in seen:
                        raise ConfigError(
                            f"terminals.{terminal}.{direction}: {name} is a field of {seen[name]} too; rename one"
                        )
                    seen[name] = terminal
