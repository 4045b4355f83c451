"""The loop's way to a wire of its own: frames from tables, datagrams, a device's clock and counter."""
