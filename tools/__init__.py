"""What `make docs` and `make lint` run on the source tree."""
