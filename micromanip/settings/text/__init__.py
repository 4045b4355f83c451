"""The configuration as text: YAML with the line of every key, and messages that point at it."""
