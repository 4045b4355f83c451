"""Fewer steps that break the same rule: what is left is where to look."""

from .campaign import interleave
from .plan import plan
from .yard import Yard

_TRIES = 3
"""What goes by real processes does not break each time."""


def shrink(folder, cell, seed, number):
    """The fewest steps found that break a rule which interleaving `number` breaks, and those rules."""
    yard = Yard(folder, cell)
    try:
        yard.start()
        steps = plan(seed, number)
        rules = _broken(yard, number, steps)
        k = 0
        while rules and k < len(steps):
            fewer = steps[:k] + steps[k + 1 :]
            found = _broken(yard, number, fewer) & rules if fewer else set()
            if found:
                steps, rules = fewer, found
            else:
                k += 1
    finally:
        yard.end()
    return steps, sorted(rules)


def _broken(yard, number, steps):
    for _ in range(_TRIES):
        if broken := interleave(yard, number, steps).broken:
            return broken
    return set()
