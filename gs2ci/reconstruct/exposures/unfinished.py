"""What a joint run keeps on a disk while it is unfinished, so that a kill costs it a minute at most.

    exposure-000.kept, …    what each exposure was observed to show, as soon as it was observed
    places.kept             where each of them was, and its first Gaussians
    fit.kept                the fit, every half minute, before each search for surfaces, and when it has ended
    surfaces-0-000.kept, …  what each search found in each exposure
    clock.kept              for how long it was worked on
    part-000.kept, …        the record of each exposure, as soon as its views are made

Every file is written whole, and names the key of what it is of: sources, settings and version. Files of another key are
not read and are replaced, as are damaged ones. What is done is read back, in the run that wrote it as in the next, so
that an exposure takes memory only while it is in work.

Here: the folder, its key, and how records become files. Not here: what is kept when (`joint`, `fit.coarse.stage`).
"""

import hashlib
import io
import pickle
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import BuiltinFunctionType, FunctionType
from typing import Any, Final, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from gs2ci import __version__
from gs2ci.core.alone import alone_in
from gs2ci.core.errors import StorageError, reason_of
from gs2ci.core.json_text import as_json
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.core.whole_file import check_place, write_whole
from gs2ci.reconstruct.fit.coarse.keeping import KeptFit, KeptSearch
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings

# Records of arrays as one file that only holds numbers and words: what an unfinished joint run keeps.
#
# A file is a pickle that names classes of this program and gives their fields. Its reader finds nothing but these, and
# what makes arrays and tensors, so that reading runs nothing (the Python documentation's "Restricting globals").
# Arrays that several fields share are written once and shared again.
#
#     gs2ci.unfinished/2 KEY SHA256\n      what follows is whole, and of these sources and settings     a pickle

MARK: Final = b"gs2ci.unfinished/2"
LONGEST_HEADER: Final = 200
_OURS: Final = "gs2ci."
# What makes arrays and their numbers, of NumPy.
_NUMPY: Final = ("ndarray", "dtype", "_reconstruct", "_frombuffer", "scalar")


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
    content = io.BytesIO()
    _Packer(content, {id(array): name for name, array in (known or {}).items()}).dump(value)
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
        return _Unpacker(io.BytesIO(body), known or {}).load()
    except (pickle.UnpicklingError, LookupError, TypeError, ValueError, AttributeError, ImportError) as error:
        raise UnreadableError(f"it does not fit this version: {error}") from error


class _Packer(pickle.Pickler):
    def __init__(self, file: io.BytesIO, known: Mapping[int, str]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._known = known

    def persistent_id(self, value: Any) -> str | None:
        return self._known.get(id(value)) if isinstance(value, np.ndarray) else None

    def reducer_override(self, value: Any) -> Any:
        """Return how a value is made again; not asked for plain values and collections of them."""
        if isinstance(value, torch.Tensor):
            return tensor, (value.detach().cpu().numpy(),)
        if isinstance(value, Holdout):
            return Holdout, (value.shot, value.pixels, value.beside)
        if _is_known(type(value)) and is_dataclass(value):
            # Without what its construction converts or draws, and without what was computed since.
            return record, (type(value), {one.name: getattr(value, one.name) for one in fields(value)})
        kind = value if isinstance(value, type | FunctionType | BuiltinFunctionType) else type(value)
        if _is_known(kind) or isinstance(value, np.generic | np.dtype):
            return NotImplemented
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot be kept")


class _Unpacker(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, known: Mapping[str, NDArray[Any]]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, name: str) -> NDArray[Any]:
        return self._known[name]

    def find_class(self, module: str, name: str) -> Any:
        if module.partition(".")[0] in {"gs2ci", "numpy"} and _is_known(found := super().find_class(module, name)):
            return found
        raise pickle.UnpicklingError(f"{module}.{name} is no record")


def record(kind: type, own: Mapping[str, Any]) -> Any:
    """Make a record of its fields as it was, without what its construction converts or draws.

    Raises:
        ValueError: Its fields are others.
    """
    if not is_dataclass(kind) or {one.name for one in fields(kind)} != set(own):
        raise ValueError(f"{kind.__name__} has other fields")
    made = object.__new__(kind)
    for name, value in own.items():
        object.__setattr__(made, name, value)
    return made


def tensor(array: NDArray[Any]) -> torch.Tensor:
    """Make a tensor of an array."""
    return torch.from_numpy(array)


def _is_known(maker: Any) -> bool:
    """Tell whether this may make what a file holds: a record or an enumeration of this program, or an array."""
    if str(maker.__module__).startswith("numpy"):
        return maker.__name__ in _NUMPY
    kept = isinstance(maker, type) and (is_dataclass(maker) or issubclass(maker, Enum | Holdout))
    return maker in (record, tensor) or (kept and str(maker.__module__).startswith(_OURS))


T = TypeVar("T")

_EVERY_S: Final = 30.0
_NAMES: Final = re.compile(r"\.?(exposure|places|fit|surfaces|part|clock)[-0-9]*\.kept(\.[0-9a-f]+\.partial)?")


def key_of_run(shots: Sequence[Shot], settings: Settings) -> str:
    """Return a hash of all that a joint run depends on: the program's version, the exposures, the settings."""
    found = hashlib.sha256(as_json([__version__, settings]).encode())
    for shot in shots:
        found.update(as_json([shot.name, shot.cfa, shot.provenance]).encode())
        for name, array in arrays_of(shot).items():
            found.update(f"{name} {array.dtype} {array.shape}".encode())
            found.update(np.ascontiguousarray(array).data)
    return found.hexdigest()[:20]


def arrays_of(shot: Shot) -> dict[str, NDArray[Any]]:
    """Return the arrays of a shot and of its truth, by name."""
    named = {**vars(shot), **{f"truth {name}": array for name, array in vars(shot.truth).items()}}
    return {name: array for name, array in named.items() if isinstance(array, np.ndarray)}


def remove(folder: Path) -> None:
    """Remove what is kept of an unfinished run, and its folder if nothing else is in it."""
    if not folder.is_dir():
        return
    for path in folder.iterdir():
        if _NAMES.fullmatch(path.name):
            path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


class Unfinished:
    """The folder of an unfinished run.

    Args:
        folder: It; made when something is kept.
        key: Of the run (`key_of_run`).
        every_s: Seconds between two states of the fit that are kept.

    `before_s`: for how long earlier starts of the same run worked.

    Raises:
        StorageError: Something else lies there, or no folder can be made.
    """

    def __init__(self, folder: Path, key: str, every_s: float = _EVERY_S) -> None:
        self.folder, self._key, self._every_s = folder.absolute(), key, every_s
        self._began_s = self._kept_s = time.monotonic()
        self.before_s = 0.0
        check_place(self.folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise StorageError(f"{folder} is not a folder", remedy="move it away, or choose another place with -o")
        foreign = [name for name in self._files() if not _NAMES.fullmatch(name)]
        if foreign:
            raise StorageError(
                f"{folder} is where an unfinished run is kept, and holds {foreign[0]}, which is no part of one",
                allowed="no such folder, or that of an unfinished run",
                remedy="move it away, or choose another place with -o",
            )

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other runs out of the folder meanwhile; it goes if nothing is kept in it.

        Raises:
            StorageError: Another run works there.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        taken = StorageError(
            f"another reconstruction works in {self.folder} now",
            allowed="one at a time for an output",
            remedy="wait for it, it may be the same; or choose another output with -o",
        )
        with alone_in(self.folder, taken):
            try:
                yield
            finally:
                with suppress(OSError):
                    self.folder.rmdir()

    def begin(self, progress: Progress) -> None:
        """Say what of an earlier run goes on; remove what is of other exposures or settings."""
        own = [name for name in self._files() if self._is_ours(self.folder / name)]
        others = [name for name in self._files() if name not in own]
        for name in others:
            (self.folder / name).unlink(missing_ok=True)
        self.before_s = self.load("clock") or 0.0
        if own:
            observed = sum(name.startswith("exposure") for name in own)
            state = "is over" if "part-000.kept" in own else "has begun" if "fit.kept" in own else "has not begun"
            progress.say(f"An unfinished run in {self.folder} goes on: {observed} exposures observed, the fit {state}.")
        elif others:
            progress.say(f"What {self.folder} kept is of other exposures, settings or version, and is not used.")

    def _files(self) -> list[str]:
        return sorted(one.name for one in self.folder.iterdir()) if self.folder.is_dir() else []

    def _is_ours(self, path: Path) -> bool:
        try:
            with path.open("rb") as file:
                return path.suffix == ".kept" and key_of(file.read(LONGEST_HEADER)) == self._key
        except (OSError, UnreadableError):
            return False

    def load(self, name: str, known: Mapping[str, NDArray[Any]] | None = None) -> Any:
        """Return what was kept under a name; None: nothing, or what cannot be used.

        Raises:
            StorageError: The disk refuses.
        """
        path = self.folder / f"{name}.kept"
        if not path.is_file() or not self._is_ours(path):
            return None
        try:
            return unpacked(path.read_bytes(), known)
        except UnreadableError:
            return None
        except OSError as error:
            raise StorageError(f"{path} cannot be read: {reason_of(error)}", remedy="check the disk") from error

    def save(self, name: str, value: Any, known: Mapping[str, NDArray[Any]] | None = None) -> None:
        """Keep a value under a name.

        Raises:
            StorageError: The disk refuses.
        """
        remedy = "make room; the same command goes on from what is kept"
        write_whole(self.folder / f"{name}.kept", packed(value, self._key, known), parents=True, remedy=remedy)

    def done(
        self, name: str, make: Callable[[], T], known: Mapping[str, NDArray[Any]] | None = None
    ) -> Callable[[], T]:
        """Make a value unless it is kept; return what reads it back from the disk."""
        if self.load(name, known) is None:
            self.save(name, make(), known)

        def read() -> T:
            found: T | None = self.load(name, known)
            if found is None:
                raise StorageError(
                    f"{self.folder / name}.kept is gone or damaged, which this run has kept there",
                    remedy="give the same command again; it goes on from what is left",
                )
            return found

        return read

    # As `fit.coarse.keeping.Keeper`.

    def is_due(self) -> bool:
        """Tell whether the fit is to be kept now."""
        return time.monotonic() - self._kept_s >= self._every_s

    def keep(self, fit: KeptFit) -> None:
        """Keep a fit in place of the one before."""
        self.save("fit", fit)
        self._kept_s = time.monotonic()
        self.save("clock", self.before_s + self._kept_s - self._began_s)

    def kept(self) -> KeptFit | None:
        """Return the fit that was kept."""
        return self.load("fit")

    def keep_search(self, search: int, exposure: int, found: KeptSearch) -> None:
        """Keep what a search found in an exposure."""
        self.save(f"surfaces-{search}-{exposure:03}", found)

    def kept_search(self, search: int, exposure: int) -> KeptSearch | None:
        """Return what a search found in an exposure."""
        return self.load(f"surfaces-{search}-{exposure:03}")
