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

Here: the folder, its key. Not here: how records become files (`packing`), what is kept when (`joint`,
`fit.coarse.stage`).
"""

import hashlib
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from gs2ci import __version__
from gs2ci.core.alone import alone_in
from gs2ci.core.errors import StorageError, reason_of
from gs2ci.core.json_text import as_json
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.core.whole_file import check_place, write_whole
from gs2ci.reconstruct.exposures.packing import LONGEST_HEADER, UnreadableError, key_of, packed, unpacked
from gs2ci.reconstruct.fit.coarse.keeping import KeptFit, KeptSearch
from gs2ci.reconstruct.settings import Settings

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
            state = "the fit has begun" if "fit.kept" in own else "nothing is fitted yet"
            progress.say(f"An unfinished run in {self.folder} goes on: {observed} exposures are observed, {state}.")
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
