"""The loop's way to a wire of its own: frames from tables, datagrams from system calls, the device's clock and counter."""
