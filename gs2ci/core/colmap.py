"""pycolmap, imported so that signals go on meaning what they meant before: `from gs2ci.core.colmap import pycolmap`.

There is none for Linux on ARM (no wheel, and no source that pip could build). There something takes its place of which
every use is a `GeometryError`, so that another way is gone or the reason said. Here also: a camera as it takes one. Not
here: any other use of it.
"""

import ctypes
import platform
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from gs2ci.core.arrays import F64
from gs2ci.core.errors import GeometryError

# More than any system's `struct sigaction` takes (152 bytes on 64-bit Linux).
_ACTION_BYTES: Final = 1024


@contextmanager
def _same_signals() -> Iterator[None]:
    """Restore at the end what each signal did at the beginning.

    Through the C library, because Python's own handlers do not know that another took their place, and only its main
    thread may set one.
    """
    sigaction = ctypes.CDLL(None).sigaction
    before = {number: ctypes.create_string_buffer(_ACTION_BYTES) for number in signal.valid_signals()}
    known = {number: action for number, action in before.items() if sigaction(int(number), None, action) == 0}
    try:
        yield
    finally:
        for number, action in known.items():
            sigaction(int(number), action, None)


class _Absent:
    """Stands for pycolmap where there is none."""

    def __getattr__(self, name: str) -> Any:
        """Refuse every use.

        Raises:
            GeometryError: Always.
        """
        raise GeometryError(
            f"this needs pycolmap ({name}), of which there is none for {platform.machine()}",
            remedy="reconstruct on an x86-64 computer: shot files and run folders are the same everywhere",
        )


# On import, its logging library takes SIGTERM and the signals of crashes. SIGTERM then kills the process at once, with
# files half-written and devices at work.
with _same_signals():
    try:
        import pycolmap
    except ModuleNotFoundError:
        # Elsewhere it can be installed, which the error says.
        if platform.machine() != "aarch64":
            raise
        pycolmap = _Absent()


@contextmanager
def quietly() -> Iterator[None]:
    """Keep pycolmap's messages off the terminal, where its results are checked by whoever uses them."""
    logging = pycolmap.logging
    level, aloud = logging.minloglevel, logging.logtostderr
    logging.minloglevel = int(logging.FATAL)
    try:
        yield
    finally:
        logging.minloglevel, logging.logtostderr = level, aloud


def colmap_camera(intrinsics: F64, size: tuple[int, int]) -> Any:
    """Return a camera matrix, [3, 3], of a picture of a height and width as pycolmap's camera."""
    parameters = [intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]]
    return pycolmap.Camera(model="PINHOLE", width=size[1], height=size[0], params=parameters)


__all__ = ["colmap_camera", "pycolmap", "quietly"]
