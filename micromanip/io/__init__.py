"""What drivers imported from here until 0.1: it is found in ``micromanip.driver`` now."""

from micromanip.moved import stand_in

_DOOR = "micromanip.driver"

stand_in(
    __name__,
    {
        "bus": ("micromanip.bus.driver", _DOOR),
        "bus_errors": ("micromanip.bus.errors", _DOOR),
        "can_bits": ("micromanip.bus.can_bits", _DOOR),
        "contract": ("micromanip.bus.cyclic", _DOOR),
        "device_identity": ("micromanip.bus.device_identity", _DOOR),
    },
)
