"""Recordings as people have them: text, MATLAB, NumPy, MCAP, HDF5, Parquet: columns with units and a clock."""

from .loader import Wanted, take
from .reading import open_telemetry, read_table
from .table import Array, Table
from .telemetry import Telemetry
from .time_series import TimeSeries

__all__ = ["Array", "Table", "Telemetry", "TimeSeries", "Wanted", "open_telemetry", "read_table", "take"]
