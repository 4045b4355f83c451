"""Recordings as people have them: text, MATLAB, NumPy, HDF5 and Parquet, read into columns with units and a clock."""

from .reading import read_table
from .table import Array, Table
from .taking import Recording, Wanted, take

__all__ = ["Array", "Recording", "Table", "Wanted", "read_table", "take"]
