"""JSON that a stranger may have written: whatever is wrong with it is a ValueError.

Here: `parse_json`. Not here: what the values mean, which is for those who asked for them.
"""

import json
from typing import Any


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
