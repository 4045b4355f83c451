"""The compile decorator of this package, whose cache is keyed by the sources of ``canbus`` too."""

from pathlib import Path

from micromanip.driver import Compiler

compiled = Compiler(__file__, also=(Path(__file__).parents[1] / "canbus",))
