"""One process at a time in a folder.

Here: the lock. Not here: whole writes (`whole_file`), the lock that a capture holds while it is written (`storage`).
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gs2ci.core.errors import StorageError


@contextmanager
def alone_in(folder: Path, refused: StorageError | None = None) -> Iterator[None]:
    """Keep out of a folder whoever asks for the same; where the file system has no such locks, nothing is kept out.

    Args:
        folder: It exists; it is locked itself, since files in it are replaced by others.
        refused: Raised if another process, or another part of this one, is in it; None: wait until it is not.

    Raises:
        OSError: The folder cannot be opened.
        StorageError: `refused`.
    """
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if refused is None else fcntl.LOCK_NB))
        except BlockingIOError as error:
            if refused is not None:
                raise refused from error
        except OSError:
            pass
        yield
    finally:
        os.close(handle)
