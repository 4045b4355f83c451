"""CAN and CAN FD frames that a DBC file describes, over any interface of python-can."""
