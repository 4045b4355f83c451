"""The controller as a service of systemd: which files and commands that takes, and to undo it."""
