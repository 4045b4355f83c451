"""All that runs at 10 kHz, and nothing else: imports numpy and numba only.

``axis.py`` is the hot path; ``cell.py`` runs it for all axes; ``loop.py`` keeps time around it.
"""
