"""Whether this machine keeps a loop's deadlines: what its settings say, and what a timed run shows."""
