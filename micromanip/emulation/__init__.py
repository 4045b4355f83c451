"""What `micromanip simulate-device` plays: devices on their real protocols, with one plant behind all of them."""
