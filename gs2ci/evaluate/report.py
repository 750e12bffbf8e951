"""The contents of `report.json`: one typed model, each of its sections a record of its own. Schema `gs2ci.report/2`.

Each figure is declared once, in the record in which it is found: what a stage finds in `gs2ci.core.run_figures`, errors
where they are measured, the rest here. Schema, JSON and reading follow from that; a figure of `Report` that a
`RunResult` has by the same name is taken from it. The JSON schema is `docs/report.schema.json`; `python -m tests.docs`
writes it. Here: the model and its reading. Not here: the sources of the figures (`gs2ci.evaluate.run_report`), the run
folder's other files (`gs2ci.evaluate.run_folder`), the possible findings (`gs2ci.core.findings`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.findings import Code, Finding
from gs2ci.core.json_text import first_fault
from gs2ci.core.run_figures import (
    Count,
    CurvePoint,
    EnsembleSection,
    ExposureSection,
    GeometrySection,
    HeldOut,
    LightSection,
    MaskMomentsSection,
    MotionSection,
    Number,
    RaceEntry,
    RegistrationSection,
    Verdict,
)
from gs2ci.core.run_records import SECONDS_KEYS
from gs2ci.evaluate.depth import DepthErrors
from gs2ci.evaluate.environment import Machine
from gs2ci.evaluate.trajectory import TrajectoryErrors
from gs2ci.evaluate.whole_folder import NO_RUN, REPORT_NAME, RUN_SCHEMA, schema_of

REGISTERED_NAME: Final = "registered.h5"
EXPOSED_NAME: Final = "exposed_views.npy"
MOTION_PICTURE_NAME: Final = "motion.png"

# No unknown keys, no value of another type, no number that is not finite: of a report, and of the records in it.
_STRICT: Final = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class OfViews:
    """A figure for every view, and its mean over them."""

    mean: Number
    per_view: list[Number]


@dataclass(frozen=True)
class Scores:
    """How close views are to the true ones; None if these are not known."""

    psnr_db: OfViews | None
    ssim: OfViews | None


@dataclass(frozen=True)
class ResidualSection:
    """Residual between the result's prediction and the measurement, in full scales of one view."""

    rms: Number
    mean_abs: Number
    heldout_rms: HeldOut


@dataclass(frozen=True)
class SurenessSection:
    """Standard errors (`gs2ci.reconstruct.uncertainty`): 68 % of the errors lie within one, 95 % within two.

    `views_mean` of the views' values, full scale 1, and the share of them with at most 0.05; `depth_median` as a share
    of depth, and the share of pixels with at most 5 %; of each camera's position, in the unit of the path, beyond what
    no image determines, and of its rotation against the others. Those of depth and poses are None without a path or if
    things move. If the order of near and far is open, errors are not normally distributed: these hold for the order
    that was taken.
    """

    views_mean: Number
    views_sure_share: Number
    depth_median: Number | None = None
    depth_sure_share: Number | None = None
    positions: list[Number] | None = None
    rotations_deg: list[Number] | None = None


@dataclass(frozen=True)
class MeasurementSection:
    """Properties of the measurement and its masks, before the reconstruction; shares are of pixels."""

    mean: Number
    masks_sha256: str
    open_share: Number
    grey_share: Number
    closed_share: Number
    saturated_share: Number | None
    weights: tuple[Number, Number]
    telemetry: bool


class SimulatedEffect(BaseModel):
    """The simulator's decision about one effect; the bound is the change if it were left out, DN rms."""

    model_config = _STRICT

    bound_rms_dn: Number | Literal["unavoidable"]
    simulated: bool
    why: str
    sampling: str


class Simulation(BaseModel):
    """How a simulated exposure was made (`gs2ci_sims.planner`)."""

    model_config = _STRICT

    tolerance_dn: Number
    error_dn: Number
    views: Count
    effects: dict[str, SimulatedEffect]


class Report(BaseModel):
    """One run.

    `psnr_db`, `ssim` and `residual` refer to the recovered views, `verdict` says from which stage they are; `scene` and
    `decode` refer to the views of these two alone. Figures that need an unknown truth are None.
    """

    model_config = _STRICT

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
    trajectory: TrajectoryErrors | None
    depth: DepthErrors | None = None
    residual: ResidualSection
    seconds: dict[str, Number]
    curve: list[CurvePoint]
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
        return self.found(Code.CAMERA_GIVEN_AT_REST) is not None

    @property
    def length_unit(self) -> str:
        """Get the unit of path, depth and scene: "mm" only if the stage of a real rig reported the poses.

        "units of 50 mm" if that of a simulated rig did, whose scene has such a unit. Otherwise "scene units", which the
        images do not determine, or "units of the stage" or "of the file", which may be converted from any unit.
        """
        source = None if self.geometry is None else self.geometry.unit_of
        if source is None:
            return "scene units"
        # `gs2ci.rig.recording` writes "rig" for real devices only.
        known = self.provenance.get("telemetry")
        if source == "stage" and isinstance(known, dict) and "unit_mm" in known:
            return f"units of {known['unit_mm']:g} mm"
        return "mm" if (source, self.provenance.get("source")) == ("stage", "rig") else f"units of the {source}"

    @property
    def of_light(self) -> bool:
        """Get whether it is sure that views are in proportion to light: those of a rig and of the simulator are.

        A file's masks fit sums of pictures that were encoded for a screen just as well, and many data sets are such.
        """
        return self.simulation is not None or self.provenance.get("source") in ("rig", "simulated rig")

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
