"""What the driver remembers of its drives from cycle to cycle."""

from __future__ import annotations

from micromanip.driver.wire import record

(
    NOT_READY,
    SWITCH_ON_DISABLED,
    READY,
    SWITCHED_ON,
    OPERATION,
    QUICK_STOP,
    FAULT_REACTION,
    FAULT,
    UNKNOWN,
) = range(9)
"""States of a drive, as its statusword tells of them."""

NOTHING, LEFT, FAULTED, LATE, STAYS, LOST = range(6)
"""Why a drive is not as it is asked to be: it left Operation enabled, was in a fault when it was to be enabled, was not
enabled in time, goes on after it was told to stop, or was permitted to operate while the link was lost."""

END = record(
    ("number", "i8"),
    ("why", "i8"),
    ("state", "i8"),
    ("status", "i8"),
    ("shown_mode", "i8"),
    ("error", "i8"),
    ("actual", "f8"),
    ("fits", "i8"),
)
"""What it said when a permission was revoked last, and how many were: before anybody looks, the cell has taken its
permission back, and what was wrong is gone."""

DRIVE = record(
    ("control_at", "i8"),
    ("status_at", "i8"),
    ("shown_at", "i8"),
    ("error_at", "i8"),
    ("actual_number", "i8"),
    ("target", "i8"),
    ("enable", "i8"),
    ("reset", "i8"),
    ("ok", "i8"),
    ("mode", "i8"),
    ("tells_following_error", "i8"),
    ("stop_word", "i8"),
    ("enable_ns", "i8"),
    ("stop_ns", "i8"),
    ("take_up", "f8"),
    ("status", "i8"),
    ("shown_mode", "i8"),
    ("error", "i8"),
    ("actual", "f8"),
    ("fits", "i8"),
    ("state", "i8"),
    ("asked", "i8"),
    ("revoked", "i8"),
    ("enabled", "i8"),
    ("taken_up", "i8"),
    ("began_ns", "i8"),
    ("stopping", "i8"),
    ("stopped_ns", "i8"),
    ("reset_was_on", "i8"),
    ("resets", "i8"),
    ("why", "i8"),
    ("losses", "i8"),
    ("end", END),
)
"""Where its words lie in the frame, the places of its channels among numbers, outputs and inputs (-1 for none), its
limits; what it said last; and whether it is ``asked`` to operate, was seen ``enabled`` since, and its target
``taken_up`` to what the loop asks for. A permission that was ``revoked`` counts only once it has been taken back.
``losses`` is how often it left Operation enabled while it was asked to operate."""
