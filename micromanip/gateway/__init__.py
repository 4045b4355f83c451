"""Web scope, cell page and metrics: an unprivileged process that reads, and asks the control socket for the rest."""
