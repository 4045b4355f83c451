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
from micromanip.bus.ethercat.esi import EsiDevice, EsiEntry, EsiPdo, esi_products, read_esi
from micromanip.bus.ethercat.esi_document import field_type
from micromanip.bus.ethercat.esi_keys import apart
from micromanip.bus.ethercat.frames import (
    DATAGRAM_BYTES,
    HEADER_BYTES,
    PROCESSED,
    STATUS_BYTES,
    WKC_BYTES,
    Datagram,
    framed,
    unframed,
)
from micromanip.bus.ethercat.process_data import PackedNumber, bytes_of, in_first_area, packed_numbers
