"""The names of the tables, so that help and a misspelt name need not wait for what makes them.

Not here: the tables (`catalogue`).
"""

from typing import Literal

TableName = Literal[
    "methods",
    "init",
    "density",
    "ablation",
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
