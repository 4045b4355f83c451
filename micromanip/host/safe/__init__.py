"""Outputs to their safe value while no controller runs."""
