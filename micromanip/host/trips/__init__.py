"""The black box: what happened around each trip, on disk, whoever dies meanwhile; and its reading in plain words.

``supervisor.py`` is the host's side of the process in ``process.py``; that takes each trip out of the telemetry with
``capture.py`` and puts it as a ``box.py`` on the ``shelf.py``. ``story.py`` and ``figure.py`` explain one.
"""
