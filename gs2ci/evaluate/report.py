"""The contents of `report.json`: one typed model, each of its sections a model of its own. Schema `gs2ci.report/2`.

A new section is a `ReportSection` and an optional field of `Report`; `gs2ci.evaluate.run_report` fills it in. The JSON
schema is `docs/report.schema.json` (`python -m tests.docs` writes it). Here: the model and its reading. Not here: the
sources of the figures (`gs2ci.evaluate.run_report`), the run folder's other files (`gs2ci.evaluate.run_folder`), the
possible findings (`gs2ci.core.findings`).
"""

from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.findings import Code, Finding
from gs2ci.core.json_text import first_fault
from gs2ci.core.run_records import SECONDS_KEYS, Verdict
from gs2ci.evaluate.depth import DepthErrors
from gs2ci.evaluate.whole_folder import NO_RUN, REPORT_NAME, RUN_SCHEMA, schema_of

REGISTERED_NAME: Final = "registered.h5"
EXPOSED_NAME: Final = "exposed_views.npy"
MOTION_PICTURE_NAME: Final = "motion.png"

# Far beyond any real figure; within it, drawing and writing cannot overflow.
Number = Annotated[float, Field(ge=-1e100, le=1e100)]
Count = Annotated[int, Field(ge=0, le=10**15)]


class ReportSection(BaseModel):
    """Part of a report: no unknown keys, no value of another type, no number that is not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class OfViews(ReportSection):
    """A figure for every view, and its mean over them."""

    mean: Number
    per_view: list[Number]


class Scores(ReportSection):
    """How close views are to the true ones; None if these are not known."""

    psnr_db: OfViews | None
    ssim: OfViews | None


class Trajectory(ReportSection):
    """Errors of the camera path (`gs2ci.evaluate.trajectory`); None if the path is too short or has no extent."""

    ate: Number
    nate: Number | None
    translation_mean: Number
    rotation_deg: Number
    rpe_t: Number | None
    rpe_r_deg: Number | None
    reversed: bool = False


class DepthSection(ReportSection):
    """Errors of depth (`gs2ci.evaluate.depth`), over all views."""

    scale: Number
    abs_rel: Number
    median_rel: Number
    rms: Number
    close_share: Number
    known_share: Number
    rank: Number | None
    median_px: Number | None
    far_off_share: Number | None

    def errors(self) -> DepthErrors:
        """Return the errors as a `DepthErrors`."""
        return DepthErrors(**self.model_dump())


class HeldOut(ReportSection):
    """Residual of each candidate on the held-out pixels, rms in full scales; None if none were held out."""

    refined: Number | None
    scene: Number | None
    decode: Number | None

    def of(self, verdict: Verdict) -> float | None:
        """Return the residual of one candidate."""
        return {"refined": self.refined, "scene": self.scene, "decode": self.decode}[verdict]


class ResidualSection(ReportSection):
    """Residual between the result's prediction and the measurement, in full scales of one view."""

    rms: Number
    mean_abs: Number
    heldout_rms: HeldOut


class FitLook(ReportSection):
    """One evaluation of a running fit (`gs2ci.core.run_records.CurvePoint`)."""

    seconds: Number
    iteration: Count
    loss: Number | None
    heldout: Number | None
    psnr_db: Number | None
    gaussians: Count


class Moved(ReportSection):
    """How far the fit moved the initial poses, rms over the views."""

    rotation_deg: Number
    share_of_path: Number


class GeometrySection(ReportSection):
    """The first camera path, and how reliable it is (`gs2ci.reconstruct.geometry`).

    `method` found it, `asked_for` was requested; `path_error_expected` is a share of the path's extent, `unit_of` names
    the source of the unit of lengths, None for the scene's own. `order_errors`: the number of standard errors by which
    the depth order is decided, by tracks and, below 6, by short fits or by what hides what in whole ones; None if there
    was no evidence.
    """

    method: str
    asked_for: str
    proxy: str
    verdict: Literal["full", "rotation_only", "static", "unsupported"]
    focal_px: Number
    focal_source: Literal["file", "estimated", "default"]
    tracks: Count
    reprojection_rms_px: Number
    parallax_px: Number
    path_error_expected: Number | None
    order_errors: Number | None = None
    reference: Count
    unit_of: str | None
    moved: Moved


class EnsembleSection(ReportSection):
    """The number of fits, how many of them the views average, and the difference between their views, full scale 1."""

    fits: Count
    averaged: Count
    spread: Number | None


class PlacementSection(ReportSection):
    """Displacement of the masks from their calibration, about the middle of the picture.

    The fields from `radial_px` on are a smooth field beyond the affine part, stated at 100 px from the middle: radial
    with the cube of the distance, then down and right with the squares of the distances below and to the right and with
    their product, and radial with the fifth power (`gs2ci.reconstruct.registration.placement`).
    """

    down_px: Number
    right_px: Number
    rotation_deg: Number
    scale: Number
    stretch: Number
    shear: Number
    radial_px: Number = 0.0
    down_dd_px: Number = 0.0
    down_dr_px: Number = 0.0
    down_rr_px: Number = 0.0
    right_dd_px: Number = 0.0
    right_dr_px: Number = 0.0
    right_rr_px: Number = 0.0
    radial5_px: Number = 0.0


class RegistrationSection(ReportSection):
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


class LightSection(ReportSection):
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
    used: list[Number] | None = Field(validation_alias=AliasChoices("used", "believed"))
    views: Literal["as-seen", "even"]


class MaskMomentsSection(ReportSection):
    """Motion while one mask was shown (`gs2ci.reconstruct.fit.scene.mask_moments`), for each mask.

    The number of `moments` with which it was fitted; the image's motion meanwhile, `motion_px`, rms; and a bound on the
    blur that a single pose per mask would cause in its view, `bounds`, in full scales.
    """

    moments: list[Count]
    motion_px: list[Number]
    bounds: list[Number]


class RaceEntry(ReportSection):
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
    heldout: list[tuple[Count, Number]]
    refined_rms: Number | None
    outcome: str


class MotionSection(ReportSection):
    """Whether things in the scene move by themselves, and the evidence for it (`gs2ci.reconstruct.hypotheses.moving`).

    Velocities of the picture's blocks would explain the share `explained` of the power of the static scene's residual,
    significantly in the share `blocks` of them; None if this was not tested. If moving scenes were `tried`,
    `heldout_rms` is each attempt's residual on the held-out pixels, and `chosen` the one that was taken. If it `moves`,
    the share `pixels_share` of the picture moves by half a pixel or more over the exposure, by `median_px` in the
    median, the fastest percent by `most_px`; `gaussians_share` is the share of the Gaussians' opacity that moves. In
    the share `unfollowed` of the picture the best still scene erred over time and the decode did not. `known_at_rest`:
    the camera was known to be at rest.
    """

    asked: Literal["auto", "off", "on"]
    tried: bool
    moves: bool
    explained: Number | None
    blocks: Number | None
    patch_gain: Number | None = None
    behind_decode: bool | None = None
    got_worse: bool | None = None
    no_path: bool | None = None
    known_at_rest: bool | None = None
    unfollowed: Number | None = None
    heldout_rms: dict[str, Number | None]
    chosen: str
    gaussians_share: Number | None
    pixels_share: Number | None
    median_px: Number | None
    most_px: Number | None


class SurenessSection(ReportSection):
    """Standard errors (`gs2ci.reconstruct.uncertainty`): 68 % of the errors lie within one, 95 % within two.

    `views_mean` of the views' values, full scale 1, and the share of them with at most 0.05; `depth_median` as a share
    of depth, and the share of pixels with at most 5 %; of each camera's position, in the unit of the path, beyond what
    no image determines, and of its rotation against the others. Those of depth and poses are None without a path or if
    things move. If the order of near and far is open, errors are not normally distributed: these hold for the order
    that was taken; `other_order` says whether depth_other.npy has depth in the other one.
    """

    views_mean: Number
    views_sure_share: Number
    depth_median: Number | None = None
    depth_sure_share: Number | None = None
    positions: list[Number] | None = None
    rotations_deg: list[Number] | None = None
    other_order: bool = False


class MeasurementSection(ReportSection):
    """Properties of the measurement and its masks, before the reconstruction; shares are of pixels."""

    mean: Number
    masks_sha256: str
    open_share: Number
    grey_share: Number
    closed_share: Number
    saturated_share: Number | None
    weights: tuple[Number, Number]
    telemetry: bool


class SimulatedEffect(ReportSection):
    """The simulator's decision about one effect; the bound is the change if it were left out, DN rms."""

    bound_rms_dn: Number | Literal["unavoidable"]
    simulated: bool
    why: str
    sampling: str


class Simulation(ReportSection):
    """How a simulated exposure was made (`gs2ci_sims.planner`)."""

    tolerance_dn: Number
    error_dn: Number
    views: Count
    effects: dict[str, SimulatedEffect]


class Machine(ReportSection):
    """What determines the run time (`gs2ci.evaluate.environment`)."""

    processor: str
    architecture: str
    usable_cores: Count
    memory_mib: Count
    system: str


class ExposureSection(ReportSection):
    """One of several exposures that share a scene; its views follow those of the exposures before it.

    `first_view` counts from 0; `path` says how its first path was found, `moved` how far the fit moved it.
    """

    name: str
    first_view: Count
    views: Count
    verdict: Verdict
    heldout_rms: HeldOut
    path: str
    moved: Moved | None


class Report(ReportSection):
    """One run.

    `psnr_db`, `ssim` and `residual` refer to the recovered views, `verdict` says from which stage they are; `scene` and
    `decode` refer to the views of these two alone. Figures that need an unknown truth are None.
    """

    schema_name: Literal["gs2ci.report/2"] = Field(RUN_SCHEMA, alias="schema")
    name: str
    views: Count = Field(ge=1)
    size: tuple[Count, Count]
    channels: Count
    cfa: str | None
    verdict: Verdict
    notes: list[Finding]
    psnr_db: OfViews | None
    ssim: OfViews | None
    scene: Scores
    decode: Scores
    trajectory: Trajectory | None
    depth: DepthSection | None = None
    residual: ResidualSection
    seconds: dict[str, Number]
    curve: list[FitLook]
    gaussians: Count
    stopped: Finding
    ensemble: EnsembleSection | None = None
    geometry: GeometrySection | None = None
    brightness: list[Number] | None = None
    light: LightSection | None = None
    mask_moments: MaskMomentsSection | None = None
    registration: RegistrationSection | None = None
    motion: MotionSection | None = None
    race: list[RaceEntry] = []
    sureness: SurenessSection | None = None
    exposures: list[ExposureSection] = []
    measured: MeasurementSection
    simulation: Simulation | None = None
    peak_mib: Number
    settings: dict[str, JsonValue]
    seed: int
    versions: dict[str, str]
    machine: Machine
    device: str = "cpu"
    provenance: dict[str, JsonValue]

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        """Refuse a report whose parts contradict each other.

        Raises:
            ValueError: A time is missing, or scores are of another number of views, or of some candidates only.
        """
        missing = [key for key in SECONDS_KEYS if key not in self.seconds]
        if missing:
            raise ValueError(f"seconds of {', '.join(missing)} are missing")
        own = Scores(psnr_db=self.psnr_db, ssim=self.ssim)
        every = [found for scores in (own, self.scene, self.decode) for found in (scores.psnr_db, scores.ssim)]
        if any((found is None) != (every[0] is None) for found in every):
            raise ValueError("some candidates are scored against the truth, and some are not")
        if any(found is not None and len(found.per_view) != self.views for found in every):
            raise ValueError(f"scores of another number of views than {self.views}")
        return self

    @property
    def heldout_rms(self) -> float | None:
        """Get the residual of the recovered views on the held-out pixels."""
        return self.residual.heldout_rms.of(self.verdict)

    @property
    def lacks_path(self) -> bool:
        """Get whether no camera path was found: depth and path then show where the fit moved a camera at rest."""
        return self.geometry is not None and self.geometry.verdict != "full"

    def check_depth(self) -> None:
        """Check that depth was measured: without a path it shows where the fit left the Gaussians, not the scene.

        Raises:
            InputError: No camera path was found.
        """
        if self.lacks_path:
            raise InputError(
                "no camera path was found in this run, and without one its depth says nothing of the scene",
                allowed="a run whose report.json has the geometry.verdict full",
                remedy="reconstruct a shot during which the camera moved sideways, or name the source of its path with "
                "--geometry",
            )

    @property
    def known_at_rest(self) -> bool:
        """Get whether the camera is known to have been at rest, so that there is neither a path nor a depth to show."""
        return self.found(Code.CAMERA_AT_REST) is not None or self.found(Code.CAMERA_GIVEN_AT_REST) is not None

    @property
    def length_unit(self) -> str:
        """Get the unit of path, depth and scene: "mm" only if the stage of a real rig reported the poses.

        Otherwise "scene units", which the images do not determine, or "units of the stage" or "of the file": a
        simulated stage moves in its scene's units, and a file may have been converted from any unit.
        """
        source = None if self.geometry is None else self.geometry.unit_of
        if source is None:
            return "scene units"
        # `gs2ci.rig.recording` writes "rig" for real devices only.
        return "mm" if (source, self.provenance.get("source")) == ("stage", "rig") else f"units of the {source}"

    def found(self, code: Code) -> Finding | None:
        """Return the first finding of a kind; None where there is none."""
        return next((note for note in (self.stopped, *self.notes) if note.code is code), None)

    def text(self) -> str:
        """Write it as JSON, a line for each value."""
        return self.model_dump_json(by_alias=True, indent=1) + "\n"


def read_report(folder: Path) -> Report:
    """Read the report of a run folder.

    Raises:
        StorageError: There is none, it is truncated, of another version, or does not follow its schema.
    """
    path = Path(folder) / REPORT_NAME
    found = schema_of(folder)
    if found != RUN_SCHEMA:
        ours = isinstance(found, str) and found.startswith("gs2ci.report/")
        remedy = "reconstruct again, or read it with the version of gs2ci that wrote it" if ours else NO_RUN
        raise StorageError(f"{path} has schema {found!r}", allowed=RUN_SCHEMA, remedy=remedy)
    try:
        return Report.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        why = str(error) if isinstance(error, OSError) else first_fault(error)
        raise StorageError(
            f"{path} does not hold what its schema promises: {why}",
            allowed="what docs/report.schema.json describes",
            remedy="reconstruct again",
        ) from error
