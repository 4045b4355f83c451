"""The compile decorator of this package: micromanip's rules, a cache keyed by these sources."""

from micromanip.driver import Compiler

compiled = Compiler(__file__)
