"""What runs on a slave's own processor: the AL state machine, mailbox, EEPROM and watchdog (ETG.1000.6, ETG.1020)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from micromanip.bus.ethercat.al_states import (
    BAD_CLOCK,
    BAD_SYNC_CYCLE,
    BOOT,
    ERROR,
    INIT,
    INVALID_CHANGE,
    INVALID_INPUTS,
    INVALID_MAILBOX,
    INVALID_OUTPUTS,
    NO_BOOT,
    NO_SYNC,
    OP,
    PREOP,
    SAFEOP,
    STATE_MASK,
    UNKNOWN_STATE,
    WATCHDOG,
)
from micromanip.bus.ethercat.process_data import bytes_of
from micromanip.bus.ethercat.registers import (
    AL_CODE,
    AL_CONTROL,
    AL_STATUS,
    DC_ACTIVATE,
    DC_OFFSET,
    DC_SPEED_START,
    DC_START,
    DC_SYNC0_CYCLE,
    DL_CONTROL,
    DL_STATUS,
    ESC_TYPE,
    FMMU,
    PORT1,
    PORT1_CLOSED,
    SII_ADDRESS,
    SII_CONFIG,
    SII_CONTROL,
    SII_DATA,
    SII_READ,
    SII_READS_8,
    SM,
    SM_ACTIVATE,
    SM_BYTES,
    SM_FULL,
    SM_PDI,
    SM_REPEAT,
    SM_STATUS,
    STATION,
    SYNC0_ON,
    SYNC_ON,
    WATCHDOG_COUNT,
    WATCHDOG_DEFAULT_DIVIDER,
    WATCHDOG_DIVIDER,
    WATCHDOG_PDI,
    WATCHDOG_SM,
    WATCHDOG_STATUS,
)

from .controller import (
    AL_ASKED,
    LOOPS_SET,
    MAIL_CAME,
    MAIL_TAKEN,
    MEMORY_BYTES,
    SII_ASKED,
    SM_CHANGED,
    WATCHDOG_TURNED,
    has_run_out,
    local_ns,
    system_ns,
)
from .mailbox import ASSIGNED_INPUTS, ASSIGNED_OUTPUTS, Mailbox, Objects
from .terminal import DIGITAL_OUTPUTS, MAILBOX_BYTES, MAILBOX_IN, MAILBOX_OUT, Area, Terminal, eeprom_of

_ESC_KIND, _RAM_KB, _PORTS = 0x11, 8, 0x0F
_WITH_CLOCK = 0x000C
"""Features: FMMUs map bits, there is a distributed clock, of 64 bits."""
_WATCHDOG_DEFAULT = 1000
_SPEED_START_DEFAULT = 0x1000
_SYNC0 = ((DC_SYNC0_CYCLE, 4), (DC_START, 8))
_MAILBOXES = Area(0, MAILBOX_OUT, 0), Area(1, MAILBOX_IN, 0)
_UPWARDS = {(INIT, PREOP), (PREOP, SAFEOP), (SAFEOP, OP)}
_WRITABLE = (
    (STATION, 2),
    (DL_CONTROL, 4),
    (AL_CONTROL, 2),
    (0x0200, 2),
    (0x0300, 20),
    (WATCHDOG_DIVIDER, 2),
    (WATCHDOG_PDI, 2),
    (WATCHDOG_SM, 2),
    (WATCHDOG_COUNT, 2),
    (SII_CONFIG, 16),
    (FMMU, 128),
    (DC_OFFSET, 12),
    (DC_SPEED_START, 6),
    (0x0980, 48),
    (DIGITAL_OUTPUTS, 4),
    (MAILBOX_OUT, MEMORY_BYTES - MAILBOX_OUT),
)


class Application:
    """One slave: `record` is its controller."""

    def __init__(
        self,
        record: Any,
        terminal: Terminal,
        left_op: Callable[[], None] = lambda: None,
        loops_set: Callable[[], None] = lambda: None,
    ) -> None:
        """`left_op` is called whenever it stops to follow its outputs, `loops_set` when a port may have been closed."""
        self._esc, self._left_op, self._loops_set = record, left_op, loops_set
        self.memory = record["memory"]
        writable = record["writable"]
        for start, length in _WRITABLE:
            writable[start : start + length] = 1
        for k in range(8):
            at = SM + k * SM_BYTES
            writable[at : at + SM_BYTES] = 1
            writable[at + SM_STATUS] = writable[at + SM_PDI] = 0
        self.become(terminal, 0)

    def become(self, terminal: Terminal, now_ns: int) -> None:
        """Be this one from now on, and switched on just now."""
        self.terminal, self._eeprom = terminal, eeprom_of(terminal)
        self.switch_on(now_ns)

    def switch_on(self, now_ns: int) -> None:
        """As after the power has come: INIT, nothing configured, the clock from 0."""
        m, esc = self.memory, self._esc
        m[:] = 0
        head = (_ESC_KIND, 0, 0, 0, 8, 8, _RAM_KB, _PORTS)
        m[ESC_TYPE : ESC_TYPE + 10] = np.frombuffer(bytes(head) + struct.pack("<H", _WITH_CLOCK), np.uint8)
        self._put(WATCHDOG_DIVIDER, WATCHDOG_DEFAULT_DIVIDER)
        self._put(WATCHDOG_PDI, _WATCHDOG_DEFAULT)
        self._put(WATCHDOG_SM, _WATCHDOG_DEFAULT)
        self._put(SII_CONTROL, SII_READS_8)
        self._put(DC_SPEED_START, _SPEED_START_DEFAULT)
        self._put(AL_STATUS, INIT)
        self._put(AL_CONTROL, INIT)
        esc["clock_began_ns"], esc["clock_adjusted_ns"] = now_ns, 0
        esc["output_manager"] = self.terminal.output_area.manager
        esc["outputs_ns"] = esc["outputs_count"] = esc["events"] = esc["begun"] = 0
        esc["powered"] = 1
        self.state, self._said, self._last_mail = INIT, b"", b""
        self._repeated = 0
        self.objects = Objects(self.terminal, lambda: self.state == PREOP)
        self._mailbox = Mailbox(self.objects, MAILBOX_BYTES)
        self.is_starved = False

    @property
    def is_closed(self) -> bool:
        """Whether the master has closed its port 1."""
        return int(self.memory[DL_CONTROL + 1]) & PORT1 == PORT1_CLOSED

    def link(self, before: bool, behind: bool) -> None:
        """Whether something is connected at port 0, towards the master, and at port 1; else the port is closed."""
        ports = (0x0210 if before else 0x0100) | (0x0820 if behind else 0x0400)
        self._put(DL_STATUS, 0x5000 | ports | 0x03)

    def serve(self, now_ns: int) -> None:
        """Do what the controller has kept for it."""
        esc = self._esc
        events, esc["events"] = int(esc["events"]), 0
        if events & LOOPS_SET:
            self._loops_set()
        if events & SII_ASKED:
            self._read_eeprom()
        if events & AL_ASKED:
            self._asked(self._get(AL_CONTROL), now_ns)
        if events & SM_CHANGED:
            self._repeat_mail()
        if events & WATCHDOG_TURNED:
            self._watch(bool(has_run_out(esc, now_ns)))
        if events & MAIL_CAME and self.state != INIT:
            self._said = self._mailbox.answer(self.memory[MAILBOX_OUT : MAILBOX_OUT + MAILBOX_BYTES].tobytes())
            self.memory[SM + SM_STATUS] &= 0xFF ^ SM_FULL
        if events & (MAIL_CAME | MAIL_TAKEN) and self._said and not self._full(1):
            self._lay_out(self._said)
            self._last_mail, self._said = self._said, b""

    def _watch(self, late: bool) -> None:
        """The watchdog of the outputs has run out, or no longer has."""
        self._put(WATCHDOG_STATUS, int(not late))
        self.is_starved &= late
        if late and self.state == OP and self.terminal.output_bytes:
            self._starve()

    def _starve(self) -> None:
        """The watchdog has run out. Without a processor the pins go to 0, and the state stays until they are served."""
        if self.is_starved:
            return
        self.memory[WATCHDOG_COUNT] = min(255, int(self.memory[WATCHDOG_COUNT]) + 1)
        if not self.terminal.is_digital:
            self.drop(WATCHDOG)
            return
        self.memory[DIGITAL_OUTPUTS : DIGITAL_OUTPUTS + 4] = 0
        self.is_starved = True
        self._left_op()

    def be_absent(self) -> None:
        """Take no part in the process data."""
        self._hold_process_data(True)

    def take_part(self) -> None:
        """Take part in the process data, where the state has any."""
        self._hold_process_data(self.state < SAFEOP)

    def drift(self, ppm: float, now_ns: int) -> None:
        """Let its clock gain so much on this machine's from now on; what it shows does not leap."""
        esc, ppb = self._esc, round(1e3 * ppm)
        shown_ns = int(local_ns(esc, now_ns))
        esc["clock_began_ns"], esc["clock_ppb"] = now_ns - shown_ns * 1_000_000_000 // (1_000_000_000 + ppb), ppb

    def drop(self, code: int, state: int = SAFEOP) -> None:
        """Leave the state by itself, for the reason that the code says."""
        self._enter(state, code)

    def _asked(self, control: int, now_ns: int) -> None:
        wanted = control & STATE_MASK
        if self._get(AL_STATUS) & ERROR and not control & ERROR and wanted != INIT:
            return  # the error has to be acknowledged first
        code = self._refusal(wanted, now_ns)
        if wanted == OP and not code:
            self._esc["outputs_ns"] = now_ns
        self._enter(self.state if code else wanted, code)

    def _refusal(self, wanted: int, now_ns: int) -> int:
        """The code with which a state is refused; 0 for none."""
        if wanted == BOOT:
            return NO_BOOT
        if wanted not in (INIT, PREOP, SAFEOP, OP):
            return UNKNOWN_STATE
        if self.terminal.is_digital:
            return 0
        if wanted > self.state and (self.state, wanted) not in _UPWARDS:
            return INVALID_CHANGE
        if wanted >= PREOP and not all(self._manages(area, MAILBOX_BYTES) for area in _MAILBOXES):
            return INVALID_MAILBOX
        if wanted >= SAFEOP:
            outputs, inputs = map(self.objects.mapped, (ASSIGNED_OUTPUTS, ASSIGNED_INPUTS))
            if not self._manages(self.terminal.output_area, bytes_of(entry.bits for entry in outputs)):
                return INVALID_OUTPUTS
            if not self._manages(self.terminal.input_area, bytes_of(entry.bits for entry in inputs)):
                return INVALID_INPUTS
            return self._refusal_of_sync(now_ns) if wanted > self.state else 0
        return 0

    def _refusal_of_sync(self, now_ns: int) -> int:
        """What is wrong with SYNC0, where it is on: in SAFEOP it must be to begin, in OP it must have begun."""
        m = self.memory
        if not m[DC_ACTIVATE] & SYNC_ON:
            return 0
        if not m[DC_ACTIVATE] & SYNC0_ON:
            return BAD_CLOCK
        cycle_ns, start_ns = (int.from_bytes(m[at : at + n].tobytes(), "little") for at, n in _SYNC0)
        if cycle_ns == 0:
            return BAD_SYNC_CYCLE
        begins = start_ns > int(system_ns(self._esc, now_ns))
        return 0 if begins == (self.state < SAFEOP) else NO_SYNC

    def _manages(self, area: Area, length: int) -> bool:
        """Whether its sync manager is set to just this area; on nothing it must be off."""
        at = SM + area.manager * SM_BYTES
        on = bool(self.memory[at + SM_ACTIVATE] & 1)
        if length == 0:
            return not on or self._get(at + 2) == 0
        return on and (self._get(at), self._get(at + 2)) == (area.start, length)

    def _enter(self, state: int, code: int = 0) -> None:
        leaves = self.state == OP != state
        self.state = state
        self._put(AL_STATUS, state | (ERROR if code else 0))
        self._put(AL_CODE, code)
        self.take_part()
        if leaves:
            self._left_op()

    def _hold_process_data(self, held: bool) -> None:
        for area in (self.terminal.output_area, self.terminal.input_area):
            self.memory[SM + area.manager * SM_BYTES + SM_PDI] = int(held)

    def _read_eeprom(self) -> None:
        command = self._get(SII_CONTROL)
        if command & SII_READ:
            start = 2 * self._get(SII_ADDRESS)
            data = self._eeprom[start : start + 8].ljust(8, b"\xff")
            self.memory[SII_DATA : SII_DATA + 8] = np.frombuffer(data, np.uint8)
        self._put(SII_CONTROL, SII_READS_8)

    def _repeat_mail(self) -> None:
        """The master may ask for the last mail once more: the frame that had it was lost."""
        at = SM + SM_BYTES
        asked = int(self.memory[at + SM_ACTIVATE]) & SM_REPEAT
        if asked != self._repeated:
            self._repeated = asked
            if self._last_mail:
                self._lay_out(self._last_mail)
            self.memory[at + SM_PDI] = asked

    def _lay_out(self, mail: bytes) -> None:
        self.memory[MAILBOX_IN : MAILBOX_IN + len(mail)] = np.frombuffer(mail, np.uint8)
        self.memory[SM + SM_BYTES + SM_STATUS] |= SM_FULL

    def _full(self, k: int) -> bool:
        return bool(self.memory[SM + k * SM_BYTES + SM_STATUS] & SM_FULL)

    def _get(self, at: int) -> int:
        return int(self.memory[at]) | int(self.memory[at + 1]) << 8

    def _put(self, at: int, value: int) -> None:
        self.memory[at], self.memory[at + 1] = value & 0xFF, value >> 8
