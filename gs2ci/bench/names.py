"""The names of the tables, so that help and a misspelt name need not wait for what makes them.

Not here: the tables (`tables`). Only `gs2ci.bench.tables` and `gs2ci.commands.bench` import this file.
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
    "seeds",
    "simulate",
    "calibrate",
]
