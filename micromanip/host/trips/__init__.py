"""The black box: what happened around each trip, on disk, whoever dies meanwhile; and its reading in plain words."""
