"""JSON: values converted for it, and parsing of text of any origin, whose every fault is a ValueError.

Here: `plain_json`, `as_json`, `parse_json`. Not here: what the values mean, which is for those who asked for them.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np


def plain_json(value: Any) -> Any:
    """Reduce a value to what JSON can hold; a number that is not finite becomes None, the unknown its text."""
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else None
        case np.generic() | np.ndarray():
            return plain_json(value.tolist())
        case Mapping():
            return {str(key): plain_json(item) for key, item in value.items()}
        case list() | tuple():
            return [plain_json(item) for item in value]
        case _ if is_dataclass(value) and not isinstance(value, type):
            return plain_json(asdict(value))
        case _:
            return str(value)


def as_json(value: Any) -> str:
    """Write a value as text, after `plain_json`."""
    return json.dumps(plain_json(value), indent=1, allow_nan=False) + "\n"


def parse_json(text: str) -> Any:
    """Parse a text.

    Raises:
        ValueError: It is no JSON, or nests deeper than Python follows; `json.loads` has a RecursionError for that,
            which no reader of files thinks of.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it nests too deep") from error
