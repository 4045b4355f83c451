"""Whether a plant is still the one that was commissioned: its figures measured again and again, and what they do."""
