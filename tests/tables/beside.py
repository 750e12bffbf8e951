"""True views of a measurement's scene from poses beside its path, read from a file, and the scores against them.

Here: `NAME.beside.npz`, a file beside a measurement `NAME.npz`, these poses, and the figures of a scene seen
from them. Not here: the simulator's views from them (`cases`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
from scipy.linalg import expm, logm

from gs2ci.core.arrays import F32, F64
from gs2ci.core.crop import middle_begins
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.evaluate.depth import DepthErrors, depth_errors, parallax_of
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.novel_views import check_full_scale
from gs2ci.evaluate.tradeoff.store import Row

_ENDING: Final = ".beside.npz"
PLACES: Final = ("between", "beyond")


@dataclass(frozen=True)
class BesideViews:
    """True views from the places of `beside_path`, in their order.

    Args:
        views: [M, H, W, C] float32, full scale 1; M = 1 if the view beyond the path is not known.
        depth: Depth from the first pose, along the optical axis, in any unit, [H, W] float32; 0 at pixels where it is
            unknown; None if it is not known at all, or is scored at the recorded views.
    """

    views: F32
    depth: F32 | None = None


def beside_path(world_to_camera: F64) -> F64:
    """Return two poses that are defined by a path and are not part of it, [2, 4, 4].

    The first lies half way between the two middle poses, the second repeats the last step beyond the end. Both
    transform with the path under any similarity of the world, so that those of a recovered path see the same as those
    of the true one. If they were placed by aligning the whole path instead, they could be wrong by some degrees: in a
    recovered path rotation can be exchanged for translation.

    Args:
        world_to_camera: A path, [N, 4, 4] with N >= 2.

    Raises:
        InputError: There are fewer than two poses.
    """
    if len(world_to_camera) < 2:
        raise InputError(f"a path of {len(world_to_camera)} poses has no place beside it", allowed="2 or more")
    before, after = world_to_camera[len(world_to_camera) // 2 - 1 :][:2]
    half = expm(logm(after @ np.linalg.inv(before)) / 2).real @ before
    beyond = world_to_camera[-1] @ np.linalg.inv(world_to_camera[-2]) @ world_to_camera[-1]
    return np.stack([half, beyond])


def beside_file(file: str) -> Path:
    """Return the path of the file with the views beside a measurement's path."""
    return Path(file).with_name(Path(file).stem + _ENDING)


def tells_beside(file: Path) -> bool:
    """Return whether a file is no measurement, but holds the views beside another measurement's path."""
    return file.name.endswith(_ENDING)


def read_beside(file: str, size: tuple[int, int] | None) -> BesideViews | None:
    """Read the true views beside a measurement's path; None if there is no such file.

    Views of uint8 and uint16 are divided by their largest value; others have full scale 1.

    Args:
        file: The measurement's file.
        size: Height and width of the middle that is kept, px; None for all of it.

    Raises:
        InputError: There is such a file, and it does not hold one or two views, values are far beyond the full scale,
            or the depth has another size.
    """
    path = beside_file(file)
    if not path.is_file():
        return None
    allowed = f"an .npz file with views [1 or 2, H, W, 1 or 3]: {', '.join(PLACES)}; and, if known, depth [H, W]"
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as arrays:
            views = arrays["views"]
            depth = arrays["depth"].astype(np.float32) if "depth" in arrays else None
        full = np.iinfo(views.dtype).max if views.dtype in (np.uint8, np.uint16) else 1
        views = (views / np.float32(full)).astype(np.float32)
    except (OSError, ValueError, KeyError, EOFError, TypeError, BadZipFile) as error:
        raise InputError(f"{path} tells no views from beside the path: {error}", allowed=allowed) from error
    fits = views.ndim == 4 and views.size and len(views) <= len(PLACES) and views.shape[3] in (1, 3)
    fits = fits and np.isfinite(views).all()
    if not fits or (depth is not None and depth.shape != views.shape[1:3]):
        told = "" if depth is None else f" and depth {list(depth.shape)}"
        raise InputError(f"{path} holds views {list(views.shape)}{told}", allowed=allowed)
    check_full_scale(path, views)
    if size is None:
        return BesideViews(views, depth)
    top, left = middle_begins((int(views.shape[1]), int(views.shape[2])), size)
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    return BesideViews(views[:, rows, columns], None if depth is None else depth[rows, columns])


def scores_beside(images: F32, true: BesideViews | None) -> Row:
    """Score images from beside the path, [2, H, W, 3], in dB; None without a truth.

    A grey truth is compared with the images' mean over colours.
    """
    row: Row = {f"{place}_psnr_db": None for place in PLACES}
    if true is None:
        return row
    shown = images if true.views.shape[3] == images.shape[3] else images.mean(axis=3, keepdims=True)
    for place, psnr_db in zip(PLACES, psnr_per_view(shown[: len(true.views)], true.views), strict=False):
        row[f"{place}_psnr_db"] = float(psnr_db)
    return row


def depth_beside(surface: F32, true: BesideViews, shot: Shot, intrinsics: F64) -> DepthErrors | None:
    """Score the depth of the scene's surface from between the middle poses, [H, W]; None if it is not known."""
    if true.depth is None:
        return None
    path = shot.truth.world_to_camera
    parallax = None if path is None else parallax_of(path, intrinsics)
    return depth_errors(surface[None], true.depth, parallax)
