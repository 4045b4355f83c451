"""Recordings as people have them: text, MATLAB, NumPy, MCAP, HDF5, Parquet: columns with units and a clock."""

from .loader import Recording, Wanted, take
from .reading import open_telemetry, read_table
from .table import Array, Table
from .telemetry import Telemetry

__all__ = ["Array", "Recording", "Table", "Telemetry", "Wanted", "open_telemetry", "read_table", "take"]
