"""What the loop and its drivers agree on: the contract, and how a driver is found."""
