"""EtherCAT for a driver that is its master: frames, registers, states and the mailbox's codes in words."""

from micromanip.bus.ethercat import coe, registers
from micromanip.bus.ethercat.al_states import (
    ERROR,
    INIT,
    OP,
    PREOP,
    SAFEOP,
    STATE_MASK,
    STATE_NAMES,
    STATUS_MASK,
    al_code_in_words,
    state_name,
)
from micromanip.bus.ethercat.coe import abort_in_words
from micromanip.bus.ethercat.frames import (
    DATAGRAM_BYTES,
    HEADER_BYTES,
    PROCESSED,
    WKC_BYTES,
    Datagram,
    framed,
    unframed,
)

__all__ = [
    "DATAGRAM_BYTES",
    "ERROR",
    "HEADER_BYTES",
    "INIT",
    "OP",
    "PREOP",
    "PROCESSED",
    "SAFEOP",
    "STATE_MASK",
    "STATE_NAMES",
    "STATUS_MASK",
    "WKC_BYTES",
    "Datagram",
    "abort_in_words",
    "al_code_in_words",
    "coe",
    "framed",
    "registers",
    "state_name",
    "unframed",
]
