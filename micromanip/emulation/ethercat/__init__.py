"""EtherCAT slaves on one end of a veth pair: slave controllers in compiled code, their applications in Python."""
