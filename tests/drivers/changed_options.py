"""Options of a driver with one key changed, for tests of what is refused."""

DELETE = object()


def put(options, way, value):
    """Set the key at the end of `way`, a sequence of keys, in nested `options`; DELETE takes it away."""
    *folders, last = way
    for key in folders:
        options = options[key]
    if value is DELETE:
        del options[last]
    else:
        options[last] = value
