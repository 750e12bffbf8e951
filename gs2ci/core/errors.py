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

import errno


class Gs2ciError(Exception):
    """Base of all errors that gs2ci raises on purpose.

    Args:
        problem: What was requested and why it is not possible; names the file, key, device or index.
        allowed: What would be accepted.
        remedy: What the user can do about it.

    Example:
        >>> try:
        ...     gs2ci.load("nothing.h5")
        ... except gs2ci.Gs2ciError as error:
        ...     print(error.problem, error.remedy, sep="; ")
        nothing.h5: no such file; check the name; `gs2ci import` makes a shot file
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
    """A file, key or value that a user gave cannot be used.

    Example:
        >>> gs2ci.load("measurement.npz", views=0)
        Traceback (most recent call last):
        gs2ci.core.errors.InputError: --views 0; allowed: ...
    """


class StorageError(Gs2ciError):
    """A shot file, run folder or bundle cannot be read or written.

    Example:
        >>> gs2ci.save("shot.h5", gs2ci.load("shot.h5"))
        Traceback (most recent call last):
        gs2ci.core.errors.StorageError: shot.h5: already exists; what to do: ...
    """


class GeometryError(Gs2ciError):
    """No camera path or depth can be found in these views.

    Example:
        A source of geometry of your own says so, and the next source is asked:

        >>> raise gs2ci.GeometryError("the camera does not move", allowed="views from different places")
        Traceback (most recent call last):
        gs2ci.core.errors.GeometryError: the camera does not move; allowed: views from different places
    """


class NumericsError(Gs2ciError):
    """A computation gave numbers that are not finite, and could not be rolled back.

    Example:
        >>> raise gs2ci.NumericsError("the denoiser returned NaN", remedy="use another denoiser")
        Traceback (most recent call last):
        gs2ci.core.errors.NumericsError: the denoiser returned NaN; what to do: use another denoiser
    """


class ResourceError(Gs2ciError):
    """The work would take more memory than it was allowed.

    Example:
        >>> raise gs2ci.ResourceError("the density rule wants 9,000,000 Gaussians", allowed="at most 5,000,000")
        Traceback (most recent call last):
        gs2ci.core.errors.ResourceError: the density rule wants 9,000,000 Gaussians; allowed: at most 5,000,000
    """


class DeviceError(Gs2ciError):
    """A device failed, refused or did not answer in time; subclasses live with the drivers.

    Example:
        >>> with gs2ci.open_rig("rig.toml") as rig:
        ...     rig.devices.stage.connect()
        ...     rig.devices.stage.move_to({"x": 1000.0})
        Traceback (most recent call last):
        gs2ci_drivers.failures.OutOfRangeError: ...
    """


def reason_of(error: Exception) -> str:
    """Return what an error says, without the number and the file of an error of the operating system."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    told = str(error)
    if isinstance(error, OSError) and told.endswith(" written"):
        # numpy's numbers ("163840 requested and 102368 written") of values, without the system's reason.
        return f"the disk took only a part of the values ({told}): it is full, or files may not be larger"
    return told


def room_after(error: Exception) -> str:
    """Return what makes room for a file that could not be written: on the disk, or under a limit on sizes."""
    full = not isinstance(error, OSError) or error.errno != errno.EFBIG
    return "free the disk" if full else "allow larger files (`ulimit -f`)"


def reason_with_file(error: Exception) -> str:
    """Return what an error says, after the file that an error of the operating system names."""
    file = error.filename if isinstance(error, OSError) and error.strerror else None
    return f"{file}: {reason_of(error)}" if file else reason_of(error)
