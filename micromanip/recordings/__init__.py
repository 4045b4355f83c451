"""Recordings as people have them: text, MATLAB, NumPy, MCAP, HDF5, Parquet: columns with units and a clock."""

from .reading import open_telemetry, read_table
from .table import Array, Table
from .taking import Recording, Wanted, take
from .telemetry import Telemetry

__all__ = ["Array", "Recording", "Table", "Telemetry", "Wanted", "open_telemetry", "read_table", "take"]
