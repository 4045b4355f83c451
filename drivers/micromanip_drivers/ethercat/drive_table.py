"""What a configuration says of its drives, as the records that the loop goes by."""

from __future__ import annotations

import math
from typing import Any

from .drive_options import CONTROLWORD, ERROR_CODE, MODE, MODE_SHOWN, MODES, STATUSWORD, fields_of
from .drive_records import LOST
from .image import Image
from .options import EthercatOptions

_STOP_WORDS = {"disable_voltage": 0x00, "quick_stop": 0x02}


def fill_drives(c: Any, options: EthercatOptions, image: Image, period_ns: int) -> None:
    """Put them into a context, the mode of operation into the frame; each must first be seen without permission."""
    outputs, inputs = list(options.outputs), list(image.inputs)
    c["drives"] = len(options.drives)
    for d, (name, drive) in zip(c["drive"], options.drives.items(), strict=False):
        terminal, mode = options.terminals[name], MODES[drive.mode]
        d["control_at"] = image.word_at(name, "outputs", CONTROLWORD)
        d["status_at"] = image.word_at(name, "inputs", STATUSWORD)
        d["shown_at"] = image.word_at(name, "inputs", MODE_SHOWN)
        d["error_at"] = image.word_at(name, "inputs", ERROR_CODE)
        d["actual_number"] = -1
        if mode.actual is not None:
            ((actual, _),) = fields_of(terminal.inputs, mode.actual)
            d["actual_number"] = inputs.index(actual)
        ((target, _),) = fields_of(terminal.outputs, mode.target)
        d["target"] = outputs.index(target)
        d["enable"] = outputs.index(drive.enable)
        d["reset"] = -1 if drive.reset is None else outputs.index(drive.reset)
        d["ok"] = inputs.index(drive.ok)
        d["mode"], d["tells_following_error"] = mode.number, int(mode.actual is not None)
        d["stop_word"] = _STOP_WORDS[drive.stop]
        d["enable_ns"], d["stop_ns"] = round(1e6 * drive.enable_ms), round(1e6 * drive.stop_ms)
        d["take_up"] = math.inf if drive.take_up_V_per_s is None else drive.take_up_V_per_s * period_ns * 1e-9
        d["revoked"], d["why"], d["reset_was_on"] = 1, LOST, 1
        c["send"]["template"][image.word_at(name, "outputs", MODE)] = mode.number
