"""What is learned from part to part, on its way into the loop: the host's side."""
