"""The names of the tables, for the help and the check of a name without importing the modules that make tables.

Not here: the tables (`catalogue`).
"""

from typing import Literal

TableName = Literal[
    "methods",
    "init",
    "density",
    "ablation",
    "mechanisms",
    "mask-ratio",
    "compression",
    "conditions",
    "literature",
    "paper",
    "path",
    "seeds",
    "simulate",
    "calibrate",
]
