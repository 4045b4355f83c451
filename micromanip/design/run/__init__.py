"""A recorded run, read once: its figures, how well they are known, its report, and two runs compared."""
