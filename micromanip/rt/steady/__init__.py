"""The turns of a bus worker in compiled code, as long as nothing happens that Python has to judge."""
