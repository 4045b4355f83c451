"""The cyclic driver `ethercat`: a master whose process data the loop itself exchanges in every cycle."""
