"""The errors a user may see, and nothing else.

    Gs2ciError
    ├── InputError        a file, key or value that a user gave cannot be used
    ├── StorageError      a shot, run folder or bundle cannot be read or written
    ├── GeometryError     no camera path or depth can be found in these views
    ├── NumericsError     a computation gave numbers that are not finite, and could not be rolled back
    ├── ResourceError     the work would take more memory than it was allowed
    └── DeviceError       a device failed, refused or did not answer in time

Every message says what was wrong, what is allowed and what to do, in that order.
"""


class Gs2ciError(Exception):
    """Base of all errors that gs2ci raises on purpose.

    Args:
        problem: What was requested and why it is not possible; names the file, key, device or index.
        allowed: What would be accepted.
        remedy: What the user can do about it.
    """

    def __init__(self, problem: str, *, allowed: str = "", remedy: str = "") -> None:
        self.problem = problem
        self.allowed = allowed
        self.remedy = remedy
        parts = [problem]
        if allowed:
            parts.append(f"allowed: {allowed}")
        if remedy:
            parts.append(f"what to do: {remedy}")
        super().__init__("; ".join(parts))


class InputError(Gs2ciError):
    """A file, key or value that a user gave cannot be used."""


class StorageError(Gs2ciError):
    """A shot file, run folder or bundle cannot be read or written."""


class GeometryError(Gs2ciError):
    """No camera path or depth can be found in these views."""


class NumericsError(Gs2ciError):
    """A computation gave numbers that are not finite, and could not be rolled back."""


class ResourceError(Gs2ciError):
    """The work would take more memory than it was allowed."""


class DeviceError(Gs2ciError):
    """A device failed, refused or did not answer in time; subclasses live with the drivers."""
