"""The file below HDF5 while a capture is written: a write that the disk refuses does not bring the library down.

Here: `GuardedFile`, which HDF5 writes through. Not here: what is written, and in which order (`writer`).

Where a write fails (a full disk, a quota, a limit on the size of files), HDF5 2.0.0 can neither go on nor close the
file: closing fails as well, and the library ends the process by a segmentation fault when Python exits. So the first
refusal is remembered here and nothing more reaches the disk. The library is told that all is well: what it still
writes is kept in memory and given back where it reads it. The writer asks for the refusal after each step, and the
file on disk stays what it was at the refusal: all rows that were marked as whole before it, and perhaps without its
end (`padding`).
"""

import errno
import fcntl
import io
import os
from pathlib import Path


class GuardedFile(io.RawIOBase):
    """A new file, locked against other writers, that keeps its first failed write to itself.

    Args:
        path: Must not exist.

    Raises:
        OSError: The file exists or cannot be created.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.refusal: OSError | None = None
        """The first write that failed; None while all is well."""
        self._at = 0
        self._size = 0
        self._unwritten: list[tuple[int, bytes]] = []
        self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        try:
            # HDF5 locks files that it opens by name in this way: a reader in another process is refused meanwhile.
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            # Some network file systems know no locks; HDF5 goes on there, too.
            if error.errno not in (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK):
                os.close(self._handle)
                raise

    def check(self) -> None:
        """Return if every write so far was taken.

        Raises:
            OSError: The first that was not.
        """
        if self.refusal is not None:
            raise OSError(self.refusal.errno, os.strerror(self.refusal.errno or errno.EIO))

    def sync(self) -> None:
        """Wait until the storage device has everything.

        Raises:
            OSError: It has not.
        """
        self.check()
        os.fsync(self._handle)

    def readable(self) -> bool:
        """Tell that it can be read."""
        return True

    def writable(self) -> bool:
        """Tell that it can be written."""
        return True

    def seekable(self) -> bool:
        """Tell that it has positions."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Go to a position, byte."""
        self._at = offset + (self._size if whence == os.SEEK_END else self._at if whence == os.SEEK_CUR else 0)
        return self._at

    def tell(self) -> int:
        """Get the position, byte."""
        return self._at

    def readinto(self, buffer: memoryview, /) -> int:  # type: ignore[override]  # whatever HDF5 hands over
        """Read from the position on; what the disk refused is read from memory, gaps are zeros."""
        view = memoryview(buffer).cast("B")
        wanted = max(0, min(len(view), self._size - self._at))
        got = os.preadv(self._handle, [view[:wanted]], self._at) if wanted else 0
        view[got:wanted] = bytes(wanted - got)
        for start, data in self._unwritten:
            first, last = max(start, self._at), min(start + len(data), self._at + wanted)
            if first < last:
                view[first - self._at : last - self._at] = data[first - start : last - start]
        self._at += wanted
        return wanted

    def write(self, data: memoryview, /) -> int:  # type: ignore[override]  # whatever HDF5 hands over
        """Write at the position, on disk or, since the first refusal, in memory."""
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

    def close(self) -> None:
        """Close the file on disk; may be called twice."""
        if not self.closed:
            os.close(self._handle)
        super().close()
