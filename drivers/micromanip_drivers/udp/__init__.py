"""The cyclic driver `udp`: a datagram out and one in, in every cycle of the loop itself."""
