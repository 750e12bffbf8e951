r"""Records of arrays as one file that only holds numbers and words: what an unfinished joint run keeps.

A file names classes of this program and gives their fields; reading it runs nothing, and makes no object of any other
kind than records, enumerations, arrays and tensors. Arrays that several fields share are written once and shared again.

    gs2ci.unfinished/1 KEY SHA256\n      what follows is whole, and of these sources and settings
    an .npz archive                      "tree": the record as JSON; "0", "1", …: its arrays

Here: the two directions. Not here: what is kept, and where (`unfinished`).
"""

import hashlib
import importlib
import io
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gs2ci.reconstruct.measurement.holdout import Holdout

MARK: Final = b"gs2ci.unfinished/1"
LONGEST_HEADER: Final = 200
_OURS: Final = "gs2ci."
_LISTS: Final[dict[str, Any]] = {"list": list, "tuple": tuple, "frozenset": frozenset}


class UnreadableError(ValueError):
    """A file is none of these, or damaged."""


def packed(value: Any, key: str, known: Mapping[str, NDArray[Any]] | None = None) -> bytes:
    """Return a value as the content of a file.

    Args:
        value: Records, enumerations, arrays, tensors, plain values, and lists, tuples and maps of these.
        key: What it is of.
        known: Arrays that whoever reads it has, by name; they are not written.

    Raises:
        TypeError: It holds something else.
    """
    packer = _Packer({id(array): name for name, array in (known or {}).items()})
    tree = packer.tree(value)
    content = io.BytesIO()
    arrays = {str(number): array for number, array in enumerate(packer.arrays)}
    np.savez(content, tree=np.frombuffer(json.dumps(tree).encode(), np.uint8), **arrays)  # type: ignore[arg-type]
    body = content.getbuffer()
    return b" ".join((MARK, key.encode(), hashlib.sha256(body).hexdigest().encode())) + b"\n" + body


def key_of(content: bytes) -> str:
    """Return what a file is of.

    Raises:
        UnreadableError: It is none of these files.
    """
    parts = content[:LONGEST_HEADER].partition(b"\n")[0].split(b" ")
    if len(parts) != 3 or parts[0] != MARK:
        raise UnreadableError("it is no file of an unfinished run")
    return parts[1].decode("ascii", "replace")


def unpacked(content: bytes, known: Mapping[str, NDArray[Any]] | None = None) -> Any:
    """Return the value of a file; arguments as for `packed`.

    Raises:
        UnreadableError: It is none of these files, damaged, or of another version of this program.
    """
    key_of(content)
    header, _, body = content.partition(b"\n")
    if hashlib.sha256(body).hexdigest().encode() != header.split(b" ")[2]:
        raise UnreadableError("it is damaged")
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            tree = json.loads(archive["tree"].tobytes())
            arrays = {int(name): archive[name] for name in archive.files if name != "tree"}
        return _Unpacker(arrays, dict(known or {})).value(tree)
    except (ValueError, KeyError, TypeError, AttributeError, ImportError, IndexError) as error:
        raise UnreadableError(f"it does not fit this version: {error}") from error


class _Packer:
    def __init__(self, known: Mapping[int, str]) -> None:
        self.arrays: list[NDArray[Any]] = []
        self._known = known
        self._numbers: dict[int, int] = {}

    def tree(self, value: Any) -> Any:
        match value:
            case Enum():
                return {"enum": _name_of(type(value)), "member": value.name}
            case np.generic():
                return {"number": self._array(np.asarray(value))}
            case None | bool() | int() | float() | str():
                return value
            case np.ndarray():
                name = self._known.get(id(value))
                return {"array": self._array(value)} if name is None else {"known": name}
            case Tensor():
                return {"tensor": self._array(value.detach().cpu().numpy(), of=value)}
            case list() | tuple() | frozenset():
                return {type(value).__name__: [self.tree(one) for one in value]}
            case dict():
                return {"map": [[self.tree(key), self.tree(one)] for key, one in value.items()]}
            case Holdout():
                return {"holdout": [self.tree(value.shot), self.tree(value.pixels), self.tree(value.beside)]}
            case _ if is_dataclass(value) and type(value).__module__.startswith(_OURS):
                own = {one.name: self.tree(getattr(value, one.name)) for one in fields(value)}
                return {"record": _name_of(type(value)), "fields": own}
        raise TypeError(f"{type(value).__module__}.{type(value).__qualname__} cannot be kept")

    def _array(self, array: NDArray[Any], of: object = None) -> int:
        # The keys are of objects that the caller holds, so that none of them is another's after it.
        at = id(array if of is None else of)
        if at not in self._numbers:
            self._numbers[at] = len(self.arrays)
            self.arrays.append(array)
        return self._numbers[at]


def _name_of(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


class _Unpacker:
    def __init__(self, arrays: dict[int, NDArray[Any]], known: dict[str, NDArray[Any]]) -> None:
        self._arrays = arrays
        self._known = known

    def value(self, tree: Any) -> Any:
        if not isinstance(tree, dict):
            return tree
        kind = next(iter(tree), None)
        match kind:
            case "enum":
                return _kind(tree["enum"], Enum)[tree["member"]]
            case "number":
                return self._arrays[tree["number"]][()]
            case "array":
                return self._arrays[tree["array"]]
            case "known":
                return self._known[tree["known"]]
            case "tensor":
                return torch.from_numpy(self._arrays[tree["tensor"]])
            case "list" | "tuple" | "frozenset":
                return _LISTS[kind](self.value(one) for one in tree[kind])
            case "map":
                return {self.value(key): self.value(one) for key, one in tree["map"]}
            case "holdout":
                return Holdout(*(self.value(one) for one in tree["holdout"]))
            case "record":
                return self._record(_kind(tree["record"], None), tree["fields"])
        raise ValueError(f"{kind} is unknown")

    def _record(self, kind: Any, own: dict[str, Any]) -> Any:
        if {one.name for one in fields(kind)} != set(own):
            raise ValueError(f"{kind.__name__} has other fields")
        # As it was, without what its construction converts or draws.
        made = object.__new__(kind)
        for name, tree in own.items():
            object.__setattr__(made, name, self.value(tree))
        return made


def _kind(name: str, base: type | None) -> Any:
    """Return a record or an enumeration of this program by its name."""
    module, _, path = name.partition(":")
    if not module.startswith(_OURS):
        raise ValueError(f"{name} is none of ours")
    found: Any = importlib.import_module(module)
    for part in path.split("."):
        found = getattr(found, part)
    if not isinstance(found, type) or not (is_dataclass(found) if base is None else issubclass(found, base)):
        raise ValueError(f"{name} is no record")
    return found
