"""Finished pieces of work on disk: one small JSON file each, named by a hash of its inputs.

Here: the key, reading, writing. Not here: the work (`trials.py`).
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from gs2ci.core.json_text import as_json, parse_json
from gs2ci.core.whole_file import write_whole

# Packages whose sources are hashed, because any change in them may change a figure.
_PACKAGES: Final = ("gs2ci", "gs2ci_drivers", "gs2ci_calibration", "gs2ci_sims")
_KEY_CHARACTERS: Final = 20

Row = dict[str, Any]


class Store:
    """A folder of finished cells.

    Args:
        folder: Where; made when the first cell is kept.
        fresh: Do everything again, whatever is there.
    """

    def __init__(self, folder: Path, *, fresh: bool = False) -> None:
        self._folder = folder
        self._fresh = fresh

    def get(self, key: str) -> Row | None:
        """Get a finished cell; None if there is none or its file is truncated (it is then done again)."""
        if self._fresh:
            return None
        try:
            row = parse_json(self._path(key).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return row if isinstance(row, dict) else None

    def put(self, key: str, row: Mapping[str, Any]) -> None:
        """Store a finished cell; it appears completely or not at all.

        Raises:
            StorageError: The disk refuses.
        """
        write_whole(self._path(key), as_json(row), parents=True)

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.json"


def content_key(work: str, arguments: Mapping[str, Any]) -> str:
    """Hash all that a cell's result depends on: the work, its arguments, and our sources."""
    digest = hashlib.sha256()
    digest.update(json.dumps([work, arguments], sort_keys=True).encode())
    digest.update(_sources_digest().encode())
    return digest.hexdigest()[:_KEY_CHARACTERS]


@cache
def _sources_digest() -> str:
    digest = hashlib.sha256()
    for path in _source_files():
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _source_files() -> Iterator[Path]:
    for package in _PACKAGES:
        spec = find_spec(package)
        for root in spec.submodule_search_locations or () if spec else ():
            yield from sorted(Path(root).rglob("*.py"))
