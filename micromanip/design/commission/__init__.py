"""From raw excitation to a tuned, validated axis, with the evidence for it."""
