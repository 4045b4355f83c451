"""What `micromanip device simulate` plays: devices on their real protocols, with one plant behind all of them."""
