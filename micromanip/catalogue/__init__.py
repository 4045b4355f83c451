"""What was recorded, tripped, reported and tuned, found again: a catalogue of files, beside which nothing is kept."""
