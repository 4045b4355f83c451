"""Control theory that configuration and design share: one formula, one place."""
