"""A calibration bundle and shots that were taken with it: `update_bundle`.

Not here: the work (`gs2ci.rig.updating`).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gs2ci.core.errors import InputError

if TYPE_CHECKING:
    from gs2ci.rig.updating import Update


def update_bundle(bundle: str | Path, shots: Sequence[str | Path]) -> "Update":
    """Correct a bundle's masks from shots that were taken with it; the old bundle is kept next to it.

    Args:
        bundle: The bundle, which is replaced if the shots contradict it.
        shots: Shot files; every exposure of each is used.

    Returns:
        The estimates, in `parameters`; those that were applied, in `taken`; the largest displacement of the masks,
        `largest_px`.

    Raises:
        DeviceError: No shot shows it, or shots contradict each other (`CalibrationError`); the bundle is unchanged.
        StorageError: A file cannot be read or written.

    Example:
        >>> gs2ci.update_bundle("bench.cal.h5", [])
        Traceback (most recent call last):
        gs2ci.core.errors.InputError: a bundle updated by no shot; ...
    """
    from gs2ci.core.storage import count_shots, read_shot
    from gs2ci.rig.updating import update_bundle as update

    if not shots:
        raise InputError("a bundle updated by no shot", allowed="a bundle and one shot file or several")
    files = [Path(file) for file in shots]
    return update(Path(bundle), [(file, read_shot(file, k)) for file in files for k in range(count_shots(file))])
