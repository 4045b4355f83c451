"""What the stages see of each other: measured, judged as one plant, and what it costs to ignore it."""
