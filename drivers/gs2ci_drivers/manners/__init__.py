"""What real devices do where one would guess otherwise: one TOML file per kind of device, read here.

Each file is named after the `kind` of a rig file and holds tables `[[manner]]` of texts: `id`, `applies` (family and
firmware), `guess`, `fact`, `source` (with its version) and `test` (the test that plays it: its file, "::", its name).
`docs/devices.md` is made of them, and `gs2ci doctor` prints those of the devices that answer.

Here: reading and checking the files. Not here: whether the named tests exist (`tests/drivers/test_manners.py`).
"""

import tomllib
from dataclasses import dataclass, fields
from importlib.resources import files
from importlib.resources.abc import Traversable

from gs2ci.core.errors import InputError


class MannersError(InputError):
    """A file of manners cannot be used."""


@dataclass(frozen=True)
class Manner:
    """One thing that a device does otherwise than one would guess.

    Args:
        id: Its name, unique among all.
        applies: To which devices and firmware.
        guess: What one would guess.
        fact: What the device does.
        source: Where that is documented.
        test: The test that plays it.
    """

    id: str
    applies: str
    guess: str
    fact: str
    source: str
    test: str


KEYS = tuple(one.name for one in fields(Manner))


def kinds() -> tuple[str, ...]:
    """Return the kinds of devices that have a file, sorted."""
    return tuple(sorted(one.name.removesuffix(".toml") for one in _folder().iterdir() if one.name.endswith(".toml")))


def manners_of(kind: str) -> tuple[Manner, ...]:
    """Return the manners of a kind of device, in the order of its file; empty if there is none.

    Raises:
        MannersError: The file is not TOML, or an entry lacks a key, has another one, or one that is no text.
    """
    file = _folder() / f"{kind}.toml"
    return read_manners(file) if kind.isidentifier() and file.is_file() else ()


def read_manners(file: Traversable) -> tuple[Manner, ...]:
    """Read one file.

    Raises:
        MannersError: As `manners_of`; also an id that stands twice.
    """
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise MannersError(f"{file.name} is not TOML: {error}", remedy="mend the line named") from error
    entries = tables.get("manner")
    if not isinstance(entries, list) or tables.keys() != {"manner"}:
        raise MannersError(f"{file.name} holds {', '.join(sorted(tables)) or 'nothing'}", allowed="tables [[manner]]")
    found = tuple(_manner(file.name, entry) for entry in entries)
    twice = sorted({one.id for one in found if [other.id for other in found].count(one.id) > 1})
    if twice:
        raise MannersError(f"{file.name}: the id {twice[0]!r} stands twice", remedy="give each entry its own")
    return found


def _manner(file: str, entry: object) -> Manner:
    keys = set(entry) if isinstance(entry, dict) else set()
    if not isinstance(entry, dict) or keys != set(KEYS):
        missing, other = sorted(set(KEYS) - keys), sorted(keys - set(KEYS))
        said = "; ".join((*(f"lacks {key}" for key in missing), *(f"has {key}" for key in other)))
        raise MannersError(f"{file}: an entry {said}", allowed=", ".join(KEYS))
    wrong = [key for key in KEYS if not isinstance(entry[key], str) or not entry[key].strip()]
    if wrong:
        raise MannersError(f"{file}: {wrong[0]} of {entry['id']!r} is no text", allowed="text that is not empty")
    return Manner(**entry)


def _folder() -> Traversable:
    return files(__name__)
