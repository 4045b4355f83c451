"""What was recorded, tripped, reported and tuned, found again: a catalogue of files, beside which nothing is kept."""

FILE = "catalogue.sqlite"
"""Its name in the state directory."""
