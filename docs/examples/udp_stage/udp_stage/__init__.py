"""An amplifier with strain gauges that is reached by UDP."""
