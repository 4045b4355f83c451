"""Types of options, one a unit, with the bounds that they have in every section of a configuration."""

from micromanip.quantities import *  # noqa: F403 (this is the door's name for that module)
