"""The laws of the cycle: parameters, state and step of one idea in one file."""
