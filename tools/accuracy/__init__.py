"""What the cell reaches, beside the paper and beside the bound: `make accuracy` writes docs/accuracy.md.

Virtual time, the truth of the simulation, seeds fixed in `cells.py`; the real loop's figures stand beside them. Each
cell is commissioned from factory values, and what was found is played with the process, on other noise than it was
found with.
"""
