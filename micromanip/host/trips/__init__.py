"""The black box: what happened around each trip, on disk, whoever dies meanwhile; and its reading in plain words.

``supervisor.py`` is the host's side of the process in ``process.py``, which takes each trip out of the telemetry and
puts it into the store, ``store.py``. ``report.py`` explains one, by what ``evidence.py`` sees in its cycles.
"""
