"""Which arrays of a file, or of two, play which part: measurement, masks, true views, weights.

Here: loading them under their keys. Not here: names of keys (`roles`), the order of axes (`axes`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.foreign import roles
from gs2ci.core.foreign.container import Array, Container
from gs2ci.core.foreign.opening import open_foreign
from gs2ci.core.foreign.options import ImportOptions

# The median of weights that are shares of an interval: a mask may be shown twice as long, and none is hardly shown.
_TYPICAL_SHARES: Final = (0.05, 2.0)


@dataclass(frozen=True)
class Found:
    """Arrays of the file by role, still in its units and orders.

    Args:
        measurement: Of all exposures, or of one that has masks of its own.
        masks: Its masks.
        truth: Its true views.
        container: The file.
        masks_container: That of the masks.
        exposure: Which of several exposures that have masks of their own.
        exposures: How many such exposures the file holds.
    """

    measurement: Array
    masks: Array
    truth: Array | None
    container: Container
    masks_container: Container
    exposure: int = 0
    exposures: int = 1

    def own(self, given: Array) -> Array:
        """Return what belongs to this exposure of poses or weights, [K, N, ...] or [K * N, ...]; [N, ...] is of all."""
        stored = len(given.values) if given.values.ndim else 0
        each, rest = divmod(stored, self.exposures)
        if self.exposures == 1 or rest or not each or stored == len(self.masks.values):
            return given
        part = given.values[self.exposure * each : (self.exposure + 1) * each]
        return Array(given.where, part[0] if each == 1 else part)


def find(path: Path, masks_path: Path | None, options: ImportOptions, guesses: list[str]) -> Found:
    """Open the files and load measurement, masks and true views.

    Raises:
        InputError: A file cannot be opened, a key is missing or plays two parts, or an array is empty.
    """
    container = open_foreign(path)
    holder = container if masks_path is None else open_foreign(masks_path)
    meas_key = roles.require_key(container, "measurement", options.meas_key, guesses)
    taken = meas_key if holder is container else None
    mask_key = roles.require_key(holder, "masks", options.mask_key, guesses, taken=taken)
    if mask_key and mask_key == taken:
        raise InputError(
            f"{path}: key {mask_key!r} for the measurement and for the masks",
            allowed="two keys",
            remedy="name the masks with --mask-key and the measurement with --meas-key",
        )
    truth_key = None if options.truth is not None else roles.key_of(container, "truth", options.truth_key, guesses)
    keys = {"measurement": meas_key, "masks": mask_key, "truth": truth_key}
    if meas_key:
        guesses.append("keys: " + ", ".join(f"{key!r} ({role})" for role, key in keys.items() if key))
    for one in {id(held): held for held in (container, holder) if held.note}.values():
        doubt = "WARNING: " * one.note.startswith("WARNING: ")
        guesses.append(f"{doubt}{one.path}: {one.note.removeprefix(doubt)}")
    measurement, masks = container.load(meas_key), holder.load(mask_key)
    truth = options.truth if truth_key is None else container.load(truth_key)
    for array in (measurement, masks):
        if array.values.size == 0:
            raise InputError(f"{array.where}: empty, shape {list(array.values.shape)}", remedy="save it again")
    if _levels(measurement) == 2 < _levels(masks):
        raise InputError(
            f"{measurement.where}: two values alone, as masks have, and {masks.where} has more",
            allowed="readings of a camera, and the masks behind which they were taken",
            remedy="exchange the two: the measurement comes first (keys: --meas-key, --mask-key)",
        )
    return Found(measurement, masks, truth, container, holder)


def _levels(array: Array) -> int:
    """Count the values of an array, up to 3."""
    levels: set[float] = set()
    for part in np.array_split(array.values.reshape(-1), max(1, array.values.size >> 16)):
        levels.update(np.unique(part).tolist())
        if len(levels) > 2:
            return 3
    return len(levels)


def chosen_masks(stack: NDArray[Any], found: Found, options: ImportOptions) -> NDArray[Any]:
    """Return as many of the masks as the user says.

    Raises:
        InputError: The file holds fewer.
    """
    if options.views is not None:
        if not 1 <= options.views <= len(stack):
            raise InputError(
                f"{found.masks.where}: --views {options.views} of {len(stack)} masks", allowed=f"1 to {len(stack)}"
            )
        stack = stack[: options.views]
    return stack


def weights_of(found: Found, stored: int, used: int, guesses: list[str]) -> F32:
    """Return the weights of the masks in use, from the measurement's file or else from that of the masks.

    Raises:
        InputError: They are no weights of these masks.
    """
    for container in (found.container, found.masks_container):
        key = roles.key_of(container, "weights", None, guesses)
        if key is not None:
            given = found.own(container.load(key))
            break
    else:
        return np.ones(used, np.float32)
    values = given.values.astype(np.float32).reshape(-1)
    fits = len(values) in (stored, used) and bool(np.isfinite(values).all())
    values = values[:used]
    if not fits or values.min() < 0 or not values.any():
        raise InputError(
            f"{given.where}: weights {values[:8].tolist()} for {used} masks",
            allowed=f"{used} numbers >= 0, the share of its interval during which each mask was exposed",
            remedy="correct them or take them out of the file",
        )
    guesses.append(f"{given.where}: weights of the masks, {values.min():.3g} to {values.max():.3g}")
    least, most = _TYPICAL_SHARES
    if not least <= float(np.median(values[values > 0])) <= most:
        guesses.append(
            f"WARNING: {given.where}: no shares of an interval, which are about 1: taken as exposure times, and "
            "divided by the longest"
        )
        values = values / values.max()
    return values
