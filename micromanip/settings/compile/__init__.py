"""From the validated configuration to per-sample gains."""
