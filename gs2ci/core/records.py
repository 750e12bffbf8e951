"""The data that stages pass to each other, as plain numpy records.

Here: `Shot`, one coded measurement with all that is known about it, and its checks. Not here: files
(`gs2ci.core.storage`), torch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool, on_host
from gs2ci.core.errors import InputError
from gs2ci.core.lens import check_distortion

CfaPattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
CFA_PATTERNS: Final = get_args(CfaPattern)

# What no bench gives, and no stage could compute with in float32: squares of such numbers leave its range. A reading
# in full scales of a view, a mask's weight, a camera's figures in pixels, a stage's way in any unit of length.
MEASUREMENT_LIMIT: Final = 1e12
WEIGHT_RANGE: Final = (1e-6, 1e6)
LONGEST_TYPICAL_SHARE: Final = 4.0
"""In the median; what is longer is an exposure time in some unit. A single mask may be shown longer."""
OPEN_LEAST: Final = 1e-6
_WEIGHTS_REMEDY: Final = (
    "give for each mask the share of its interval during which it was exposed, or leave the weights out if it is the "
    "same for all"
)
FOCAL_RANGE_PX: Final = (1e-3, 1e9)
PRINCIPAL_POINT_LIMIT_PX: Final = 1e6
POSITION_LIMIT: Final = 1e12
# Matrices that were written as text with four digits still pass.
ROTATION_TOLERANCE: Final = 1e-3
# The solver has no skew, here as a share of the focal length. This much moves the corner of a wide picture by a
# quarter of a pixel in five hundred; calibrations that fit a skew find less than that by noise.
SKEW_LIMIT: Final = 1e-3


# Without a comparison by content (eq=False): numpy gives no single answer to whether two arrays are equal.
@dataclass(frozen=True, eq=False)
class Truth:
    """The truth of a shot, from simulation or a reference; any part may be missing.

    Args:
        views: True views, [N, H, W, C] float32, full scale 1.
        world_to_camera: True poses, [N, 4, 4], OpenCV axes.
        depth: True depth of each view's pixels along the optical axis, [N, H, W] float32, in the unit of the poses; 0
            where it is not known.

    Other kinds of arrays, such as torch tensors, are converted to numpy.

    Example:
        >>> import numpy as np, gs2ci
        >>> gs2ci.Truth(views=np.zeros((4, 24, 32, 3))).views.dtype
        dtype('float32')
    """

    views: F32 | None = None
    world_to_camera: F64 | None = None
    depth: F32 | None = None

    def __post_init__(self) -> None:
        _take_over(self, views=np.float32, world_to_camera=np.float64, depth=np.float32)


@dataclass(frozen=True, eq=False)
class Shot:
    """One coded measurement with its calibrated masks: Y = Σᵢ wᵢ Mᵢ ⊙ Xᵢ + Z (paper, eq. 1).

    Other kinds of arrays, such as torch tensors, are converted to numpy arrays of the stated types.

    Args:
        measurement: Y, [H, W, C] float32 with C = 3 (RGB) or 1 (mono or colour mosaic). The unit is the full
            scale of one view: a white scene under m open masks measures m.
        masks: M, [N, H, W] float32 in [0, 1], in the order of exposure.
        weights: w, [N] float32: the share of its nominal interval during which each mask was exposed; 1 if none are
            given.
        cfa: Colour filter array of a single-channel measurement; None for RGB and mono.
        intrinsics: Camera matrix in pixels, [3, 3], or None when it is not known. Pixel centres lie at +0.5.
        distortion: The lens's coefficients k1 k2 p1 p2 k3 in OpenCV's convention (`gs2ci.core.lens`), [5], which
            belong to the intrinsics; None for a pinhole. Masks, measurement and views are distorted, as on the sensor.
        truth: The truth, for scoring only; no solver reads it.
        telemetry_world_to_camera: Poses as the stage reported them, [N, 4, 4], or None.
        saturated: Pixels whose reading is clipped, and therefore only a lower bound, [H, W] bool, or None.
        name: For reports.
        provenance: Where it came from and what was guessed, for reports.

    Example:
        >>> import numpy as np, gs2ci
        >>> masks = np.random.default_rng(0).random((4, 24, 32)) < 0.5
        >>> shot = gs2ci.Shot(masks.sum(axis=0)[..., None], masks).check()
        >>> shot.views, shot.size, shot.measurement.dtype
        (4, (24, 32), dtype('float32'))
    """

    measurement: F32
    masks: F32
    # None is replaced in __post_init__.
    weights: F32 = None  # type: ignore[assignment]
    cfa: CfaPattern | None = None
    intrinsics: F64 | None = None
    distortion: F64 | None = None
    truth: Truth = field(default_factory=Truth)
    telemetry_world_to_camera: F64 | None = None
    saturated: Bool | None = None
    name: str = "shot"
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _take_over(
            self,
            measurement=np.float32,
            masks=np.float32,
            weights=np.float32,
            intrinsics=np.float64,
            distortion=np.float64,
            telemetry_world_to_camera=np.float64,
            saturated=np.bool_,
        )
        given: F32 | None = self.weights
        if given is None:
            object.__setattr__(self, "weights", np.ones(self.masks.shape[:1], np.float32))

    @property
    def views(self) -> int:
        """Get the number of views, N."""
        return int(self.masks.shape[0])

    @property
    def size(self) -> tuple[int, int]:
        """Get height and width in pixels."""
        return int(self.masks.shape[1]), int(self.masks.shape[2])

    @property
    def transmissions(self) -> F32:
        """Get the products of masks and weights, [N, H, W]."""
        return self.masks * self.weights[:, None, None]

    @property
    def lit(self) -> Bool:
        """Get the pixels that at least one mask opens, [H, W]."""
        return np.asarray(self.masks[self.weights > 0].any(axis=0))

    def weights_by(self, factors: Sequence[float] | F64 | None) -> F32:
        """Return the weights times factors, [N], as a run corrected them; its own for None."""
        return self.weights if factors is None else (self.weights * np.array(factors)).astype(np.float32)

    @property
    def usable(self) -> Bool:
        """Get the pixels whose readings are exact and of light: lit, and not saturated, [H, W]."""
        return self.lit if self.saturated is None else self.lit & ~self.saturated

    @property
    def channels(self) -> int:
        """Get the number of colour channels of a recovered view: 3, or 1 for a mono measurement."""
        return 3 if self.cfa else int(self.measurement.shape[2])

    def _repr_png_(self) -> bytes | None:
        """Show the measurement, the first mask and, if known, the middle true view; nothing of what is no shot."""
        return None if self._fault() is not None else self._drawn()

    def _drawn(self) -> bytes:
        from gs2ci.core.notebook import png_of, row_of  # noqa: PLC0415  pictures are drawn only when shown

        brightest = max(float(np.nanmax(self.measurement, initial=0.0)), 1e-12)
        shown: list[NDArray[Any]] = [self.measurement / brightest, self.masks[0]]
        if self.truth.views is not None:
            shown.append(self.truth.views[self.views // 2])
        return png_of(row_of(shown))

    def _repr_html_(self) -> str:
        from gs2ci.core.notebook import card  # noqa: PLC0415  as above

        fault = self._fault()
        if fault is not None:
            return card(f"{self.name}: cannot be used", [("why", fault)])
        height, width = self.size
        colours = f"{self.cfa} mosaic" if self.cfa else "RGB" if self.channels == 3 else "mono"
        known = [
            name
            for name, part in (
                ("views", self.truth.views),
                ("path", self.truth.world_to_camera),
                ("depth", self.truth.depth),
            )
            if part is not None
        ]
        focal = "not known" if self.intrinsics is None else f"{self.intrinsics[0, 0]:.4g} px focal length"
        facts = [
            ("pixels", f"{width} × {height}, {colours}"),
            ("masks", f"{self.views}, open at {100 * float(self.masks.mean()):.3g} % of their pixels"),
            ("weights", f"{float(self.weights.min()):.3g} to {float(self.weights.max()):.3g}"),
            ("camera", focal + (", with distortion" if self.distortion is not None else "")),
            ("stage's path", "no" if self.telemetry_world_to_camera is None else "yes"),
            ("known truth", ", ".join(known) or "none"),
        ]
        shown = "measurement, first mask" + (", middle true view" if self.truth.views is not None else "")
        return card(self.name, facts, self._drawn(), caption=shown)

    def _fault(self) -> InputError | None:
        """Return why this cannot be used; None if it can."""
        try:
            self.check()
        except InputError as error:
            return error
        return None

    def check(self) -> "Shot":
        """Return self if all parts fit together.

        Raises:
            InputError: A part is of another kind, shapes disagree, a number is not finite or unreasonably large, masks
                are negative, above one or all zero, the colour filter array does not fit the channels, or the
                distortion folds the picture.
        """
        _check_kinds(self)
        _check_measurement(self)
        _check_masks(self)
        _check_optional_parts(self)
        return self


def _take_over(record: "Shot | Truth", **kinds: type[np.generic]) -> None:
    """Convert a record's fields to numpy arrays of given types; None stays where a field may be left out.

    An array of the given type, which may be large, is copied only if it is not C-contiguous (torch takes no negative
    strides) or read-only (torch warns of that).

    Raises:
        InputError: A field holds no numbers, or masked ones.
    """
    left_out = {part.name for part in fields(record) if part.default is None}
    for name, kind in kinds.items():
        given = getattr(record, name)
        if given is None and name in left_out:
            continue
        try:
            held = on_host(given)
            found = np.asarray(held)
            # Objects would turn into NaN, text into numbers, complex numbers into their real parts.
            if found.dtype.kind not in "biuf":
                raise TypeError(f"it holds {found.dtype}")
            if np.ma.is_masked(held):
                raise TypeError("some of its numbers are masked")
            taken = np.require(found, kind, ("C", "W"))
        except (TypeError, ValueError, RuntimeError) as error:  # the last of tensors without data, or lazily negated
            raise InputError(
                f"{name} of a {type(record).__name__.lower()} is {type(given).__name__}, no array of numbers: {error}",
                allowed="a numpy array, a torch tensor, or nested lists of real numbers",
            ) from error
        object.__setattr__(record, name, taken)


def _finite(what: str, array: NDArray[Any], remedy: str = "correct them, or leave them out") -> None:
    bad = int(array.size - np.isfinite(array).sum())
    if bad:
        raise InputError(f"{what} holds {bad} values that are NaN or infinite", allowed="finite numbers", remedy=remedy)


def _shape(what: str, got: tuple[int, ...], wanted: tuple[int, ...]) -> None:
    if got != wanted:
        raise InputError(
            f"{what} has shape {list(got)}", allowed=str(list(wanted)), remedy="check the order of the axes"
        )


def _check_kinds(shot: Shot) -> None:
    """Check the parts that are no arrays: files and reports could not be written with other kinds, or not be read."""
    for name, kind, allowed in (
        ("truth", Truth, "gs2ci.Truth(views=..., world_to_camera=..., depth=...)"),
        ("name", str, "a text"),
        ("provenance", dict, "a dictionary"),
    ):
        part = getattr(shot, name)
        if not isinstance(part, kind):
            raise InputError(
                f"{name} of a shot is {type(part).__name__}",
                allowed=allowed,
                remedy=f"give such a {name}, or leave it out",
            )


def _check_measurement(shot: Shot) -> None:
    y = shot.measurement
    if y.ndim != 3 or y.shape[2] not in (1, 3) or 0 in y.shape:
        raise InputError(
            f"measurement has shape {list(y.shape)}",
            allowed="[H, W, 3] for RGB, [H, W, 1] for mono or a colour mosaic",
            remedy="give a picture [H, W] as picture[..., None]"
            if y.ndim == 2
            else "give one image; a stack of images is several shots",
        )
    _finite("measurement", y, "mend these pixels, or import the file with --bad-pixels median")
    largest = float(np.abs(y).max(initial=0.0))
    if largest > MEASUREMENT_LIMIT:
        raise InputError(
            f"the measurement reaches {largest:.3g} full scales of a view",
            allowed=f"up to {MEASUREMENT_LIMIT:g}",
            remedy="import it with --scale set to the reading of a white scene under one open mask",
        )
    if shot.cfa is not None and (shot.cfa not in CFA_PATTERNS or y.shape[2] != 1):
        raise InputError(
            f"colour filter array {shot.cfa!r} on a measurement with {y.shape[2]} channels",
            allowed=f"one of {', '.join(CFA_PATTERNS)} on a single-channel measurement",
            remedy="drop the pattern for RGB or mono measurements",
        )


def _check_masks(shot: Shot) -> None:
    masks, y = shot.masks, shot.measurement
    if masks.ndim != 3 or masks.shape[0] < 1:
        raise InputError(f"masks have shape {list(masks.shape)}", allowed="[N, H, W] with N >= 1")
    _shape("masks", masks.shape, (masks.shape[0], *y.shape[:2]))
    _finite("masks", masks, "set every mask to 0 at these pixels: they are then left out")
    if masks.min() < 0 or masks.max() > 1:
        raise InputError(
            f"masks reach from {masks.min():.9g} to {masks.max():.9g}",
            allowed="transmissions in [0, 1]",
            remedy="set what lies below 0 to 0, if it is the noise of a calibration"
            if masks.min() < 0
            else "divide them by the reading of a fully open mask (`gs2ci import --mask-scale`), and set what then "
            "lies above 1 to 1, if it is noise",
        )
    if not masks.any():
        raise InputError("all masks are zero", remedy="check that the masks were exposed and saved")
    if masks.max() < OPEN_LEAST:
        raise InputError(
            f"no mask lets through more than {masks.max():.3g} of the light",
            allowed=f"{OPEN_LEAST:g} or more at some pixel",
            remedy="import with --mask-scale set to the reading of a fully open mask",
        )
    _shape("weights", shot.weights.shape, (masks.shape[0],))
    _finite("weights", shot.weights, _WEIGHTS_REMEDY)
    if shot.weights.min() < 0 or not shot.weights.any():
        raise InputError(
            f"mask weights {shot.weights.tolist()}",
            allowed="numbers >= 0, not all zero",
            remedy=_WEIGHTS_REMEDY,
        )
    least, most = WEIGHT_RANGE
    if not least <= shot.weights.max() <= most:
        raise InputError(
            f"the largest mask weight is {shot.weights.max():.3g}",
            allowed=f"{least:g} to {most:g}; 1 for a mask exposed during the whole of its interval",
            remedy=_WEIGHTS_REMEDY,
        )
    typical = float(np.median(shot.weights[shot.weights > 0]))
    if typical > LONGEST_TYPICAL_SHARE:
        raise InputError(
            f"the mask weights are {typical:.3g} in the median, which are no shares of an interval: views would be as "
            "much too dark",
            allowed=f"about 1, up to {LONGEST_TYPICAL_SHARE:g}",
            remedy="divide exposure times by the longest",
        )
    if not shot.lit.any():
        raise InputError("every mask is closed or has weight zero", remedy=_WEIGHTS_REMEDY)


def _check_optional_parts(shot: Shot) -> None:
    n, (height, width) = shot.views, shot.size
    if shot.intrinsics is not None:
        check_intrinsics(shot.intrinsics)
    if shot.distortion is not None:
        if shot.intrinsics is None:
            raise InputError(
                "a distortion is given without intrinsics",
                allowed="both, as they were measured together",
                remedy="give the camera matrix as well, or leave the distortion out",
            )
        check_distortion(shot.distortion, shot.intrinsics, shot.size)
    for what, poses in (
        ("true poses", shot.truth.world_to_camera),
        ("telemetry poses", shot.telemetry_world_to_camera),
    ):
        if poses is not None:
            _shape(what, poses.shape, (n, 4, 4))
            _finite(what, poses)
    if shot.truth.views is not None:
        _shape("true views", shot.truth.views.shape, (n, height, width, shot.channels))
        _finite("true views", shot.truth.views)
    if shot.truth.depth is not None:
        _shape("true depth", shot.truth.depth.shape, (n, height, width))
        _finite("true depth", shot.truth.depth)
        if (shot.truth.depth < 0).any():
            raise InputError(
                "true depth holds negative values",
                allowed="distances along the optical axis; 0 where none is known",
                remedy="mark pixels of unknown depth with 0",
            )
    if shot.saturated is not None:
        _shape("saturated", shot.saturated.shape, (height, width))


def are_rigid(poses: F64) -> bool:
    """Tell whether poses, [N, 4, 4], are rigid motions of a reasonable size."""
    rotations = poses[:, :3, :3]
    turned = np.abs(poses).max() <= POSITION_LIMIT and np.allclose(
        rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=ROTATION_TOLERANCE
    )
    return bool(turned and np.allclose(poses[:, 3], (0, 0, 0, 1)) and (np.linalg.det(rotations) > 0).all())


def check_rigid(what: str, poses: F64) -> None:
    """Check that poses, [N, 4, 4], are rigid motions of a reasonable size.

    Raises:
        InputError: They scale, mirror, or are too far away.
    """
    if not are_rigid(poses):
        raise InputError(
            f"{what} are no rigid motions",
            allowed=f"[[R, t], [0 0 0 1]] with rotations R and |t| up to {POSITION_LIMIT:g}",
            remedy="give world-to-camera matrices, OpenCV axes, without scale",
        )


def check_intrinsics(matrix: F64) -> None:
    """Check a pinhole camera matrix in pixels.

    Raises:
        InputError: Not [3, 3], not finite, focal lengths or principal point out of range, a skew, or a last row other
            than 0 0 1.
    """
    _shape("intrinsics", matrix.shape, (3, 3))
    _finite("intrinsics", matrix)
    shortest, longest = FOCAL_RANGE_PX
    # In Python's own numbers, since every rendering asks: numpy takes ten times as long for so few.
    (fx, skew, cx), (skew_y, fy, cy), last = matrix.tolist()
    focal_fits = shortest <= fx <= longest and shortest <= fy <= longest
    centre_fits = max(abs(cx), abs(cy)) <= PRINCIPAL_POINT_LIMIT_PX
    square = abs(skew) <= SKEW_LIMIT * fx and abs(skew_y) <= SKEW_LIMIT * fy
    # With the tolerances of numpy's `allclose`.
    ends = all(abs(value - one) <= 1e-8 + 1e-5 * one for value, one in zip(last, (0, 0, 1), strict=True))
    if not focal_fits or not centre_fits or not square or not ends:
        raise InputError(
            f"intrinsics {matrix.tolist()}",
            allowed=f"[[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, with fx and fy from {shortest:g} to {longest:g} "
            f"and cx, cy within ±{PRINCIPAL_POINT_LIMIT_PX:g}",
            remedy="leave them out to have the focal length estimated",
        )
