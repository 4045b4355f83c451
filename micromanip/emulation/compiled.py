"""The compile decorator of all emulated devices: micromanip's rules, a cache keyed by the sources of them all."""

from micromanip.rt.jit import Compiler

compiled = Compiler(__file__)
