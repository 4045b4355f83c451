"""The control socket: who may ask for what, and the one way in which a value of a running controller is changed."""
