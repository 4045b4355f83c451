"""Pages that are generated from the schema."""
