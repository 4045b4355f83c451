"""What a path asks of the stage, computed before a part is mounted."""
