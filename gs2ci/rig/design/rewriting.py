"""A rig file with other numbers in its [capture]; all else in it stays as it is written, comments included.

Here: this. Not here: writing files (`gs2ci.core.whole_file`), what the numbers should be (`candidates`).
"""

import re
import tomllib
from collections.abc import Mapping
from typing import Final

from gs2ci.core.errors import InputError

_HEADER: Final = re.compile(r"\s*\[\s*capture\s*\]\s*(#.*)?$")
_ANY_HEADER: Final = re.compile(r"\s*\[")


def with_capture(text: str, numbers: Mapping[str, int | float]) -> str:
    """Return the text of a rig file with some keys of its [capture] set.

    Args:
        text: The file's text, valid TOML.
        numbers: Keys, and what they are set to.

    Raises:
        InputError: [capture] is not written as a table with one key a line.
    """
    lines = text.splitlines(keepends=True)
    end = "\r\n" if text.count("\r\n") > text.count("\n") / 2 else "\n"
    begin = next((number for number, line in enumerate(lines) if _HEADER.match(line.rstrip())), None)
    if begin is None:
        lines += [*([end] if lines and not lines[-1].endswith(("\n", "\r")) else []), end, f"[capture]{end}"]
        begin = len(lines) - 1
    stop = next((n for n in range(begin + 1, len(lines)) if _ANY_HEADER.match(lines[n])), len(lines))
    # New keys go before the blank lines and comments that introduce the next table.
    last = max((n for n in range(begin, stop) if n == begin or re.match(r"\s*[\w\"'-]", lines[n])), default=begin)
    if not lines[last].endswith(("\n", "\r")):
        lines[last] += end
    added = []
    for key, value in numbers.items():
        written = re.compile(rf"(\s*[\"']?{re.escape(key)}[\"']?\s*=\s*)([^#\r\n]*?)(\s*(?:#[^\r\n]*)?[\r\n]*)$")
        found = next((n for n in range(begin + 1, stop) if written.match(lines[n])), None)
        if found is None:
            added.append(f"{key} = {value!r}{end}")
        else:
            match = written.match(lines[found])
            assert match is not None
            lines[found] = f"{match[1]}{value!r}{match[3]}"
    lines[last + 1 : last + 1] = added
    made = "".join(lines)
    _check(text, made, numbers)
    return made


def _check(before: str, after: str, numbers: Mapping[str, int | float]) -> None:
    """Check that nothing but the numbers has changed.

    Raises:
        InputError: Something has.
    """
    wanted = tomllib.loads(before)
    wanted["capture"] = {**wanted.get("capture", {}), **numbers}
    try:
        same = tomllib.loads(after) == wanted
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        raise InputError(
            "[capture] of the rig file cannot be changed where it is written",
            allowed="a table [capture] with one key a line",
            remedy="write it so in a copy of the rig file",
        )
