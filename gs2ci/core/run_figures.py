"""The figures of a run that its stages find, each declared once: for the result, the report and its schema.

Here: one record for each section of `report.json` that a stage fills. Not here: the arrays beside them (`run_records`),
the report, which adds the figures that need the truth (`gs2ci.evaluate.report`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, Literal, get_args

from pydantic import AliasChoices, Field

Verdict = Literal["refined", "scene", "decode"]
VERDICTS: Final = get_args(Verdict)

# Far beyond any real figure; within it, drawing and writing cannot overflow.
Number = Annotated[float, Field(ge=-1e100, le=1e100)]
Count = Annotated[int, Field(ge=0, le=10**15)]


@dataclass(frozen=True)
class HeldOut:
    """Residual of each candidate on the held-out pixels, rms in full scales; None if none were held out."""

    refined: Number | None
    scene: Number | None
    decode: Number | None

    def of(self, verdict: Verdict) -> float | None:
        """Return the residual of one candidate."""
        return {"refined": self.refined, "scene": self.scene, "decode": self.decode}[verdict]


@dataclass(frozen=True)
class CurvePoint:
    """State of a running fit at one time.

    Args:
        seconds: Time since the reconstruction began, decode and geometry included.
        iteration: Iterations of the fit done so far.
        loss: The fit's loss on the pixels that it uses.
        heldout: Root-mean-square residual on the held-out pixels, in the measurement's unit; None without any.
        psnr_db: Mean PSNR over the views, or None if the truth is not known.
        gaussians: Size of the population.
    """

    seconds: Number
    iteration: Count
    loss: Number | None
    heldout: Number | None
    psnr_db: Number | None
    gaussians: Count


@dataclass(frozen=True)
class Moved:
    """How far the fit moved the initial poses, rms over the views; `share_of_path` is 0 for a camera at rest."""

    rotation_deg: Number
    share_of_path: Number


@dataclass(frozen=True, kw_only=True)
class GeometrySection:
    """The first camera path, and how reliable it is (`gs2ci.reconstruct.geometry`).

    `method` found it, `asked_for` was requested; `path_error_expected` is a share of the path's extent, `unit_of` names
    the source of the unit of lengths, None for the scene's own. `order_errors`: the number of standard errors by which
    the depth order is decided, by tracks and, below 6, by what hides what in whole fits; None if there was no evidence.
    """

    method: str
    asked_for: str
    proxy: str
    verdict: Annotated[str, Field(pattern="^(full|rotation_only|static|unsupported)$")]
    focal_px: Number
    focal_source: Annotated[str, Field(pattern="^(file|estimated|default)$")]
    tracks: Count
    reprojection_rms_px: Number
    parallax_px: Number
    path_error_expected: Number | None
    order_errors: Number | None = None
    reference: Count
    unit_of: str | None
    moved: Moved


@dataclass(frozen=True)
class EnsembleSection:
    """The number of fits, how many of them the views average, and the difference between their views, full scale 1."""

    fits: Count
    averaged: Count
    spread: Number | None


@dataclass(frozen=True)
class PlacementSection:
    """Where masks lie on the sensor, relative to where they are stated to lie.

    The fields from `radial_px` on are of a smooth field beyond the affine part, and stated at 100 px from the middle.

    Args:
        down_px: Shift along the columns.
        right_px: Shift along the rows.
        rotation_deg: Turn about the middle, clockwise as the picture is seen.
        scale: Enlargement less 1, of both axes.
        stretch: How much more rows are enlarged than the average of both; columns are enlarged so much less.
        shear: Half the angle, in radians, by which the axes lean towards each other.
        radial_px: How far outwards; grows with the third power of the distance.
        down_dd_px: How far down, below the middle; grows with the square of that distance.
        down_dr_px: How far down, below it and as far to the right of it; grows with the product.
        down_rr_px: How far down, to the right of it.
        right_dd_px: How far to the right, below it.
        right_dr_px: How far to the right, below it and as far to the right of it.
        right_rr_px: How far to the right, to the right of it.
        radial5_px: How far outwards; grows with the fifth power of the distance.
    """

    down_px: Number = 0.0
    right_px: Number = 0.0
    rotation_deg: Number = 0.0
    scale: Number = 0.0
    stretch: Number = 0.0
    shear: Number = 0.0
    radial_px: Number = 0.0
    down_dd_px: Number = 0.0
    down_dr_px: Number = 0.0
    down_rr_px: Number = 0.0
    right_dd_px: Number = 0.0
    right_dr_px: Number = 0.0
    right_rr_px: Number = 0.0
    radial5_px: Number = 0.0


@dataclass(frozen=True, kw_only=True)
class RegistrationSection:
    """The masks' position, blur and transmission as estimated from the measurement (`gs2ci.reconstruct.registration`).

    `bent_px` is the largest displacement of masks by a smooth field beyond the best affine map. `first_mask` is the
    index, from 0, in the given list of the mask that was shown first. `widening_px` is how far open elements extend
    beyond their stated edges. `not_let_in` holds parameters that were estimated and not corrected: value and standard
    error, which is null where the measurement does not determine the value at all.
    """

    changed: bool
    orientation: str
    peak_ratio: Number
    placement: PlacementSection
    largest_displacement_px: Number
    bent_px: Number = 0.0
    blur_sigma_px: Number
    blur_px2: Number
    leak: Number
    widening_px: Number = 0.0
    black: Number
    unit: Number
    open_level: Number
    clipped_share: Number
    first_mask: int
    standard_errors: dict[str, Number]
    not_let_in: dict[str, list[Number | None]]


@dataclass(frozen=True)
class LightSection:
    """Brightness of the views relative to their weights (`gs2ci.reconstruct.measurement.brightness`).

    `estimated` for each view with its `standard_errors`; the largest deviation is `errors_away` of its own standard
    errors, and the estimate `explains` this share of the residual on pixels that were not used for it. `used` holds
    the values that the fit uses after its rounds; None if the given weights are used. `views` says whether the returned
    views have the brightness that was seen, or that of constant light.
    """

    estimated: list[Number]
    standard_errors: list[Number]
    errors_away: Number
    explains: Number
    # Runs of before were written with a name that did not say whose it was.
    used: Annotated[list[Number] | None, Field(validation_alias=AliasChoices("used", "believed"))]
    views: Literal["as-seen", "even"]


@dataclass(frozen=True)
class MaskMomentsSection:
    """Motion while one mask was shown (`gs2ci.reconstruct.fit.scene.mask_moments`), for each mask.

    The number of `moments` with which it was fitted; the image's motion meanwhile, `motion_px`, rms; and a bound on the
    blur that a single pose per mask would cause in its view, `bounds`, in full scales.
    """

    moments: list[Count]
    motion_px: list[Number]
    bounds: list[Number]


@dataclass(frozen=True)
class RaceEntry:
    """What became of one hypothesis of path, depth order and motion (`gs2ci.reconstruct.hypotheses`).

    `hypothesis` says where it comes from, `path` where its camera path does. It entered when all fits together had made
    `began` iterations, and made `iterations` of the `schedule` of a whole fit. `heldout` holds pairs of iteration and
    residual on the held-out pixels, `refined_rms` that of its refined views if the jury compared them.
    """

    hypothesis: str
    path: str
    began: Count
    iterations: Count
    schedule: Count
    heldout: Sequence[tuple[Count, Number]]
    refined_rms: Number | None
    outcome: str


@dataclass(frozen=True, kw_only=True)
class MotionSection:
    """Whether things in the scene move by themselves, and the evidence for it (`gs2ci.reconstruct.hypotheses.moving`).

    Velocities of the picture's blocks would explain the share `explained` of the power of the static scene's residual,
    significantly in the share `blocks` of them; None if this was not tested. If moving scenes were `tried`,
    `heldout_rms` is each attempt's residual on the held-out pixels, and `chosen` the one that was taken. If it `moves`,
    the share `pixels_share` of the picture moves by half a pixel or more over the exposure, by `median_px` in the
    median, the fastest percent by `most_px`; `gaussians_share` is the share of the Gaussians' opacity that moves. In
    the share `unfollowed` of the picture the best still scene erred over time and the decode did not.
    """

    asked: Literal["auto", "off", "on"]
    tried: bool
    moves: bool
    explained: Number | None
    blocks: Number | None
    unfollowed: Number | None = None
    heldout_rms: dict[str, Number | None]
    chosen: str
    gaussians_share: Number | None
    pixels_share: Number | None
    median_px: Number | None
    most_px: Number | None


@dataclass(frozen=True)
class ExposureSection:
    """One of several exposures that share a scene; its views follow those of the exposures before it.

    `first_view` counts from 0; `path` says how its first path was found, `moved` how far the fit moved it, `seen_alone`
    the share of what its middle view shows that no other exposure shows: it would be lost without this one.
    """

    name: str
    first_view: Count
    views: Count
    verdict: Verdict
    heldout_rms: HeldOut
    path: str
    moved: Moved | None
    seen_alone: Number | None = None
