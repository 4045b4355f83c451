"""What drivers' tests imported from here until 0.1: it is found in ``micromanip.driver`` now."""

from micromanip.moved import stand_in

stand_in(
    __name__,
    {
        "conformance": ("micromanip.driver.conformance", "micromanip.driver.conformance"),
        "virtual": ("micromanip.virtual.cell", "micromanip.driver.testing"),
    },
)
