"""Long experiments that look for faults no test thinks of: ``python -m campaigns`` lists them, ``make campaign`` too.

Each stands in a module of its name with a function ``run``: it takes what was asked and hands back a report.
"""
