"""Files that others may have tampered with: regular ones only, written whole or not at all."""
