"""A file on disk that is read as if it had a length of its own: zeros follow its end up to there.

Here: position, reading and closing, which `guarded_file` and `padding` share, for HDF5's driver of file objects. Not
here: writing, and why a length differs from the disk's.
"""

import io
import os


class SizedFile(io.RawIOBase):
    """An open file and the length that it is read as.

    Args:
        handle: Open for reading; closed with this.
        size_bytes: The length.
    """

    # While there is none: a file that could not be opened is closed as any other when it goes.
    _handle = -1

    def __init__(self, handle: int, size_bytes: int) -> None:
        super().__init__()
        self._handle = handle
        self._size = size_bytes
        self._at = 0

    def readable(self) -> bool:
        """Tell that it can be read."""
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
        """Read from the position on; zeros where the disk has nothing."""
        view = memoryview(buffer).cast("B")
        wanted = max(0, min(len(view), self._size - self._at))
        got = os.preadv(self._handle, [view[:wanted]], self._at) if wanted else 0
        view[got:wanted] = bytes(wanted - got)
        self._at += wanted
        return wanted

    def close(self) -> None:
        """Close the file on disk; may be called twice."""
        if not self.closed and self._handle >= 0:
            os.close(self._handle)
        super().close()
