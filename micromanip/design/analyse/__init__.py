"""What a configuration, a running cell or a path is worth: margins, errors by cause, health."""
