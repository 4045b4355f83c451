"""Every key of the configuration: type, unit, bounds, default and meaning."""
