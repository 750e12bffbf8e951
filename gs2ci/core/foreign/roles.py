"""Which key of a file is the measurement, which the masks, the truth, the camera.

Here: the names in use (SCINeRF, PnP-SCI, EfficientSCI, cacti and our own) and the choice between them.
"""

from typing import Final, Literal

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Container

Role = Literal[
    "measurement",
    "masks",
    "truth",
    "intrinsics",
    "focal",
    "distortion",
    "world_to_camera",
    "camera_to_world",
    "telemetry",
    "weights",
    "cfa",
    "white",
    "dark",
]

# In order of preference; compared without regard to case.
ALIASES: Final[dict[Role, tuple[str, ...]]] = {
    "measurement": ("meas", "measurement", "measurements", "meas_bayer", "snapshot", "coded", "y"),
    "masks": ("masks", "mask", "mask_bayer", "phi", "patterns", "codes"),
    "truth": ("truth", "orig", "ground_truth", "groundtruth", "gt", "views", "orig_bayer"),
    "intrinsics": ("k", "intrinsics", "intrinsic", "camera_matrix", "mtx", "cameramatrix", "kk"),
    "focal": ("focal_px", "focal"),
    "distortion": (
        *("distortion", "dist", "dist_coeffs", "distcoeffs", "dist_coeff", "distcoeff"),
        *("distortion_coeffs", "distortion_coefficients", "kc"),
    ),
    "world_to_camera": ("world_to_camera", "w2c", "extrinsics"),
    "camera_to_world": ("camera_to_world", "c2w"),
    "telemetry": ("telemetry_world_to_camera",),
    "weights": ("weights",),
    "cfa": ("cfa", "bayer", "bayer_pattern", "bayer_mode"),
    "white": ("white", "whites", "white_frame", "flat", "flats", "flat_field", "flatfield", "white_field"),
    "dark": ("dark", "darks", "dark_frame", "dark_field", "darkfield", "black", "background", "bias"),
}
CODED: Final = "np.einsum('nhw,nhw->hw', masks, views)"
"""How true views, which benchmarks hold alone, become a measurement."""
_FLAGS: Final[dict[Role, str]] = {"measurement": "--meas-key", "masks": "--mask-key", "truth": "--truth-key"}


def key_of(container: Container, role: Role, said: str | None, guesses: list[str]) -> str | None:
    """Choose the key that plays a role, or None where none does.

    Args:
        container: The file.
        role: What is looked for.
        said: The key the user named, "none" for «leave it out», None for «guess».
        guesses: Sentences are added here.

    Raises:
        InputError: The user named a key that is not there.
    """
    if said == "none":
        return None
    if said is not None:
        return _key_said(container, said)
    by_name = names_of(container)
    found = [by_name[alias] for alias in ALIASES[role] if alias in by_name]
    if role in ("measurement", "masks"):
        # The coordinates of a picture are often called y, and its defects mask.
        found.sort(key=lambda key: -min(_sides(container, key), 2 if role == "measurement" else 3))
    if len(found) > 1:
        flag = f"; choose with {_FLAGS[role]}" if role in _FLAGS else ""
        guesses.append(f"{role}: key {found[0]!r}, not {', '.join(map(repr, found[1:]))}{flag}")
    return found[0] if found else None


def _sides(container: Container, key: str) -> int:
    """Count the axes of an array that are longer than 1: 2 or more of a picture, 3 of a stack."""
    return sum(side > 1 for side in container.entries[key].shape)


def _key_said(container: Container, said: str) -> str:
    """Return the key that the user named, in groups also by its last name, where it is one's."""
    key = said if said in container.entries else names_of(container).get(said.lower())
    if key is None:
        raise InputError(f"{container.path}: no key {said!r}", allowed=container.listing())
    return key


def names_of(container: Container) -> dict[str, str]:
    """Return keys by their names without regard to case; arrays in groups also by their last name, where it is one's.

    Octave writes a variable as a group with its type and its value.
    """
    last: dict[str, list[str]] = {}
    for key in container.entries:
        if "/" in key and not key.endswith("/type"):
            last.setdefault(key.removesuffix("/value").rpartition("/")[2].lower(), []).append(key)
    return {name: keys[0] for name, keys in last.items() if len(keys) == 1} | {
        key.lower(): key for key in container.entries
    }


def require_key(
    container: Container, role: Role, said: str | None, guesses: list[str], *, taken: str | None = None
) -> str:
    """Choose the key that plays a role that must be filled; a file's only image or stack needs no name.

    Args:
        container: The file.
        role: What is looked for.
        said: The key the user named, or None for «guess».
        guesses: Sentences are added here.
        taken: A key that already plays another role.

    Raises:
        InputError: No key fits.
    """
    key = key_of(container, role, said, guesses)
    if key is not None and (said is not None or _sides(container, key) >= 2):
        return key
    if taken == "":
        raise InputError(
            f"{container.path}: {container.listing()}, which cannot be measurement and masks at once",
            remedy="give the masks as a second file, or as a folder of pictures",
        )
    known = {alias for aliases in ALIASES.values() for alias in aliases}
    entries = container.entries
    free = [
        one
        for one, entry in entries.items()
        if len(entry.shape) >= 2 and entry.kind == "number" and one != taken and one.lower() not in known
    ]
    # MATLAB's scalars and lists have two axes as well.
    free = [one for one in free if _sides(container, one) >= 2] or free
    if said is None and len(free) == 2 and (stack := _stack_of(container, free)) is not None:
        chosen = next(one for one in free if (one == stack) == (role == "masks"))
        guesses.append(
            f"{role}: key {chosen!r}, of two arrays without known names the one with an axis "
            f"{'more' if chosen == stack else 'less'}; choose with {_FLAGS[role]}"
        )
        return chosen
    if len(free) == 1 and said is None:
        if free[0]:
            guesses.append(f"{role}: key {free[0]!r}, the only array without a known name")
        return free[0]
    if key is not None:
        return key
    if not any(entry.kind == "number" for entry in entries.values()) and entries:
        container.load(next(iter(entries)))  # says what it holds instead, and the way out
    raise InputError(
        f"{container.path}: no key for the {role}; {container.listing()}",
        allowed=f"one of {', '.join(ALIASES[role])}",
        remedy=f"name the key with {_FLAGS[role]}"
        + (", or give the masks as a second file" if role == "masks" else "")
        + (f"; of true views alone: {CODED}" if role == "measurement" else ""),
    )


def _stack_of(container: Container, keys: list[str]) -> str | None:
    """Return which of two arrays is a stack of such as the other, along its first or last axis."""
    image, stack = sorted(keys, key=lambda key: len(container.entries[key].shape))
    one, many = container.entries[image].shape, container.entries[stack].shape
    return stack if len(one) == 2 and one in (many[1:], many[:-1]) else None
