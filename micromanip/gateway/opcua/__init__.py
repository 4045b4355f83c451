"""The cell for OPC UA clients: what it is, what it does, its faults as events, and the four orders."""
