"""Drivers with one thing wrong each; every check of the suite has at least one that it must find.

``broken("test_x")`` says which check that is; what else it names replaces attributes of the contract's class.
"""

BROKEN = []


def broken(check, **changed):
    def note(driver):
        BROKEN.append((driver, check, changed))
        return driver

    return note
