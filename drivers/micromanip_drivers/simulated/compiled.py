"""The compile decorator of this package: micromanip's rules, a cache keyed by these sources."""

from micromanip.rt.jit import Compiler

compiled = Compiler(__file__)
