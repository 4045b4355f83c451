"""The recurrent network of the hysteresis and of its inverse."""
