"""JSON: conversion of values, and parsing of text of any origin, with a ValueError for every fault.

Here: `plain_json`, `as_json`, `parse_json`, `first_fault`. Not here: the meaning of the values, which readers check.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pydantic import ValidationError


def plain_json(value: Any) -> Any:
    """Convert a value for JSON; a number that is not finite becomes None, an unknown object its text."""
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
        ValueError: It is no JSON, or nested too deeply; `json.loads` raises a RecursionError then, which readers of
            files do not expect.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it nests too deep") from error


def first_fault(error: "ValidationError") -> str:
    """Return the place and the text of the first fault that pydantic found: `trials.0.seconds: Input should be ...`."""
    first = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(str(part) for part in first['loc']) or 'the whole'}: {first['msg']}"
