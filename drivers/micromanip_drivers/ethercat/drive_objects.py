"""What a drive is told once, before it operates: that its mode is one of its own, and its option codes."""

from __future__ import annotations

from micromanip.driver import DeviceFault

from .drive_options import MODES, Drive
from .mailbox import Mailbox

_SUPPORTED_MODES = 0x6502
_CODE_BYTES = 2


def prepare_drive(mailbox: Mailbox, name: str, drive: Drive) -> None:
    """Write the option codes and read them back.

    Raises DeviceFault for a drive that lacks the mode, or keeps to other codes.
    """
    mode = MODES[drive.mode]
    try:
        supported = mailbox.read_number(_SUPPORTED_MODES, 0, 4)
    except DeviceFault:  # a drive need not say; the mode that it shows is looked at in every cycle
        supported = mode.supported
    if not supported & mode.supported:
        raise DeviceFault(f"{name} has no mode {drive.mode} (0x6502 is 0x{supported:08x})")
    for index, code in drive.codes.objects.items():
        mailbox.write(index, 0, code.to_bytes(_CODE_BYTES, "little", signed=True))
        kept = int.from_bytes(mailbox.read(index, 0), "little", signed=True)
        if kept != code:
            raise DeviceFault(f"{name} keeps option code 0x{index:04x} at {kept}, {code} was written")
