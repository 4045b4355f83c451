"""The simulated cell: plant, machining force, robot deviation and tracker behind a cyclic driver."""
