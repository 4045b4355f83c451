"""What comes from devices and goes to them: one image, gate, codec, socket and clock for the loop and its workers."""
