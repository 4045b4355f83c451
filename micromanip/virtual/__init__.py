"""The controller in virtual time: the loop's own code on any cyclic driver, as fast as it computes."""
