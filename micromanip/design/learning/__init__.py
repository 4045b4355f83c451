"""Learning over identical parts: the share of the path error that repeats, taken off by a correction that is played."""
