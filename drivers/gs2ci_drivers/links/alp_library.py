"""The ALP library of ViALUX as a `LibraryPort`: found and loaded by alp4lib (MIT), called with its own return codes.

alp4lib knows the library's name for each version and platform. Its methods are not used: they drop the code of an error
for a text, fail on codes that they do not know (KeyError), pass AlpProjInquire an argument too many, and take results
in a long, which has 64 bits on Linux where the library writes 32: a temperature below 0 becomes a large number. The
types here are those of the maker's header (alp.h: `long`, which is int32_t on Linux).

Here: the calls. Not here: what they do (`gs2ci_drivers.alp`). Needs the extra `alp`.
"""

import ctypes
import errno
from collections.abc import Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

from gs2ci_drivers.failures import AccessError, UnsupportedError


class AlpLibrary:
    """The maker's library, loaded.

    Args:
        device: Name of the modulator, for messages.
        version: Of the interface, "4.3".
        folder: Where the library is.

    Raises:
        UnsupportedError: The extra is not installed.
        AccessError: The library is not there, or cannot be loaded.
    """

    def __init__(self, device: str, version: str, folder: Path) -> None:
        try:
            import ALP4  # noqa: PLC0415  only where a device of this kind is opened
        except ModuleNotFoundError as error:
            raise UnsupportedError(
                device,
                f"a ViALUX device needs the package {error.name}, which is not installed",
                asked="load the maker's library",
                remedy="pip install 'gs2ci[alp]'",
            ) from error
        try:
            with redirect_stdout(StringIO()):  # it prints the path
                self._functions: Any = ALP4.ALP4(version=version, libDir=str(folder))._ALPLib
        except OSError as error:
            raise AccessError(
                device,
                f"the ALP library {version} cannot be loaded ({error})",
                asked="load the maker's library",
                remedy="install ViALUX's ALP software, set `library` in [modulator] to its folder, and `version`",
            ) from error

    def call(self, function: str, numbers: Sequence[int], data: bytes = b"") -> int:
        """Call a function; see `LibraryPort`."""
        block = [ctypes.create_string_buffer(data, len(data))] if data else []
        return int(self._function(function)(*map(_int32, numbers), *block))

    def ask(self, function: str, numbers: Sequence[int]) -> tuple[int, int]:
        """Call a function that writes a number; see `LibraryPort`."""
        value = ctypes.c_int32(0)
        code = int(self._function(function)(*map(_int32, numbers), ctypes.byref(value)))
        return code, value.value

    def close(self) -> None:
        """Make no further call."""
        self._functions = None

    def _function(self, name: str) -> Any:
        if self._functions is None:
            raise OSError(errno.EIO, "the library was closed")
        function = getattr(self._functions, name)
        function.restype = ctypes.c_int32
        return function


def _int32(number: int) -> ctypes.c_int32:
    return ctypes.c_int32(number)
