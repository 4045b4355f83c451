"""Serial lines, TCP and UDP: binary frames, lines of text, and streams of samples, laid out by the configuration."""
