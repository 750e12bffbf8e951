"""The file below HDF5 while a capture is written: a failed write does not crash the library.

Here: `GuardedFile`, which HDF5 writes through. Not here: what is written, and in which order (`writer`).

If a write fails (a full disk, a quota, a limit on the size of files), HDF5 2.0.0 can neither continue nor close the
file: closing fails as well, and the library ends the process with a segmentation fault when Python exits. So the first
failure is recorded here, and nothing more is written to the disk. For the library all later writes succeed: they are
kept in memory, from which it reads them back. The writer checks for the failure after each step. The file on disk stays
as it was at the failure: with all rows that were marked as complete before it, and possibly without its end
(`padding`).
"""

import errno
import fcntl
import os
from pathlib import Path

from gs2ci.core.storage.sized_file import SizedFile


class GuardedFile(SizedFile):
    """A new file, locked against other writers, that keeps its first failed write to itself.

    Args:
        path: Must not exist.

    Raises:
        OSError: The file exists or cannot be created.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666), 0)
        self.refusal: OSError | None = None
        """The first write that failed; None while all is well."""
        self._unwritten: list[tuple[int, bytes]] = []
        try:
            # HDF5 locks files that it opens by name in this way: a reader in another process is refused meanwhile.
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            # Some network file systems know no locks; HDF5 goes on there, too.
            if error.errno not in (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK):
                self.close()
                raise

    def check(self) -> None:
        """Check that every write so far succeeded.

        Raises:
            OSError: The first failure.
        """
        if self.refusal is not None:
            raise OSError(self.refusal.errno, os.strerror(self.refusal.errno or errno.EIO))

    def sync(self) -> None:
        """Wait until the storage device has everything.

        Raises:
            OSError: It failed.
        """
        self.check()
        os.fsync(self._handle)

    def writable(self) -> bool:
        """Tell that it can be written."""
        return True

    def readinto(self, buffer: memoryview, /) -> int:  # type: ignore[override]  # whatever HDF5 hands over
        """Read from the position on; data that could not be written are read from memory, gaps are zeros."""
        begin = self._at
        wanted = super().readinto(buffer)
        view = memoryview(buffer).cast("B")
        for start, data in self._unwritten:
            first, last = max(start, begin), min(start + len(data), begin + wanted)
            if first < last:
                view[first - begin : last - begin] = data[first - start : last - start]
        return wanted

    def write(self, data: memoryview, /) -> int:  # type: ignore[override]  # whatever HDF5 hands over
        """Write at the position, on disk or, after the first failure, in memory."""
        view, start = memoryview(data).cast("B"), self._at
        written = 0
        if self.refusal is None:
            try:
                while written < len(view):
                    written += os.pwrite(self._handle, view[written:], start + written)
            except OSError as error:
                self.refusal = error
        if written < len(view):
            self._unwritten.append((start + written, bytes(view[written:])))
        self._at = start + len(view)
        self._size = max(self._size, self._at)
        return len(view)

    def truncate(self, size: int | None = None, /) -> int:
        """Make it that long, byte, by zeros where it was shorter."""
        size = self._at if size is None else size
        if self.refusal is None:
            try:
                os.ftruncate(self._handle, size)
            except OSError as error:
                self.refusal = error
        self._unwritten = [(start, data[: max(0, size - start)]) for start, data in self._unwritten]
        self._size = size
        return size
