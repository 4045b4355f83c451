"""A CAN bus in software: keeps bit time and arbitration, and can be made to fail as real ones do."""
