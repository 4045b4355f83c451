"""What goes over the wire: datagrams, big-endian, with a CRC-32 at their end; bytes in brackets.

- "?": who are you?
- "!" serial number (4): the amplifier's answer; from then on it sends to who asked
- "S" counter (1) strain x (4) strain y (4): strains in nm, signed, at 1000 Hz
- "V" voltage x (2) voltage y (2): voltages in steps of 5 mV, signed; not answered
"""

import struct
import zlib

WHO, IAM, STRAINS, VOLTAGES = struct.Struct(">c"), struct.Struct(">cI"), struct.Struct(">cBii"), struct.Struct(">chh")
UM_PER_STEP, V_PER_STEP = 1e-3, 5e-3
STRAIN_RATE_HZ = 1000.0
COUNTS = 256


def sealed(body):
    """A datagram: `body` and its checksum."""
    return body + zlib.crc32(body).to_bytes(4, "big")


def opened(datagram, layout):
    """The fields of a datagram of this layout behind its kind; None where length or checksum are wrong."""
    body, checksum = datagram[:-4], datagram[-4:]
    if len(body) != layout.size or zlib.crc32(body).to_bytes(4, "big") != checksum:
        return None
    return layout.unpack(body)[1:]
