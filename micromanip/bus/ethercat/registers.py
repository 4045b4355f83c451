"""Where the registers of a slave controller (ESC) lie, and the commands of datagrams (IEC 61158-4-12)."""

from __future__ import annotations

NOP, APRD, APWR, APRW, FPRD, FPWR, FPRW, BRD, BWR, BRW, LRD, LWR, LRW, ARMW, FRMW = range(15)
"""Commands: by position (AP), station address (FP), to all (B), logical (L); read, write, both, read by one and written
by the others."""

ETHERTYPE = 0x88A4
TYPE_DATAGRAMS = 1

ESC_TYPE, FEATURES = 0x0000, 0x0008
STATION = 0x0010
DL_CONTROL, DL_STATUS = 0x0100, 0x0110
AL_CONTROL, AL_STATUS, AL_CODE = 0x0120, 0x0130, 0x0134
WATCHDOG_DIVIDER, WATCHDOG_PDI, WATCHDOG_SM = 0x0400, 0x0410, 0x0420
WATCHDOG_STATUS, WATCHDOG_COUNT = 0x0440, 0x0442
SII_CONFIG, SII_CONTROL, SII_ADDRESS, SII_DATA = 0x0500, 0x0502, 0x0504, 0x0508
FMMU, FMMU_BYTES = 0x0600, 16
SM, SM_BYTES = 0x0800, 8
DC_PORTS, DC_SYSTEM, DC_UNIT, DC_OFFSET, DC_DELAY, DC_DIFFERENCE = 0x0900, 0x0910, 0x0918, 0x0920, 0x0928, 0x092C
DC_SPEED_START = 0x0930
"""Begins the drift compensation: what is written, be it what stands there, empties its filters."""
DC_CONTROL, DC_ACTIVATE, DC_START, DC_SYNC0_CYCLE = 0x0980, 0x0981, 0x0990, 0x09A0
"""The SYNC unit: who controls it (a byte), what is on (a byte), when SYNC0 begins (8 bytes), its period in ns (4)."""
DL_RULES, DL_FOR_A_SECOND = 0x01, 0x02
"""Bits of ``DL_CONTROL``: frames that are not EtherCAT's are destroyed, as is usual; the settings hold for a second."""
PORT1, PORT1_CLOSED = 0x0C, 0x0C
"""Of the byte behind it, the loops of the ports, two bits each: all of port 1, and what closes it."""
SYNC_ON, SYNC0_ON = 0x01, 0x02
"""Bits of ``DC_ACTIVATE``."""

SM_CONTROL, SM_STATUS, SM_ACTIVATE, SM_PDI = 4, 5, 6, 7
"""Bytes within a sync manager: what it holds, whether it is on, what the slave itself says of it."""
SM_FULL = 0x08
SM_REPEAT = 0x02
"""Of ``SM_ACTIVATE``: changed, it asks for the last mail once more; the slave follows it in ``SM_PDI``."""
SM_MAILBOX, SM_FROM_MASTER, SM_WATCHDOG = 0x02, 0x04, 0x40
"""Bits of a sync manager's control byte: it is a mailbox, the master writes it, it feeds the watchdog."""

SII_READ, SII_BUSY, SII_READS_8 = 0x0100, 0x8000, 0x0040
"""In ``SII_CONTROL``: read at the address; still at it; it reads 8 bytes at a time, not 4."""

WATCHDOG_DEFAULT_DIVIDER, WATCHDOG_TICK_NS = 2498, 40
"""A watchdog's unit is (divider + 2) of these ticks: 100 us by default."""
