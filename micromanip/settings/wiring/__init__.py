"""Names of the configuration resolved to drivers, channels and places of the bus image."""
