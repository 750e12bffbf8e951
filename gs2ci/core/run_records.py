"""The result of a finished reconstruction, as plain numpy records.

Here: `RunResult`, and the checks that keep incomplete results out of run folders. Not here: the figures
of its sections (`run_figures`), the run folder itself (`gs2ci.evaluate.run_folder`), the Gaussians (`gs2ci.render`),
the measurement (`gs2ci.core.records`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.findings import Finding
from gs2ci.core.lens import check_distortion
from gs2ci.core.records import Shot, check_intrinsics
from gs2ci.core.run_figures import (
    VERDICTS,
    CurvePoint,
    EnsembleSection,
    ExposureSection,
    GeometrySection,
    LightSection,
    MaskMomentsSection,
    MotionSection,
    RaceEntry,
    RegistrationSection,
    Verdict,
)
from gs2ci.core.uncertainty import Uncertainty

SECONDS_KEYS: Final = ("total", "decode", "geometry", "fit")


@dataclass(frozen=True)
class RunResult:
    """The complete result of a reconstruction, except the Gaussians themselves.

    Args:
        views: The delivered views, [N, H, W, C] float32, full scale 1, not clamped.
        scene_views: The scene rendered from the N recovered cameras, [N, H, W, C] float32.
        depth: Distance along the optical axis, [N, H, W] float32 in scene units, 0 where there is no surface; None
            if no depth was found.
        depth_spread: Spread along the ray of the absorption of which depth is the median, as a share of depth: half
            the distance between the quantiles 0.16 and 0.84, [N, H, W] float32; None if no depth was found.
        depth_confidence: Share of a pixel's light absorbed within 5 % of its depth, [N, H, W] float32; likewise.
        world_to_camera: Recovered poses, [N, 4, 4] float64, OpenCV axes.
        intrinsics: Camera matrix in pixels, [3, 3] float64, given or estimated.
        distortion: Of the lens through which all views are seen, [5] as in `Shot`; None for a pinhole.
        decode: The views as decoded without a scene, [N, H, W, C] float32.
        predicted_measurement: The coded measurement of the delivered views, [H, W, Cm] float32.
        curve: The fit's course, earliest first; empty if nothing was fitted.
        stopped: Why the fit ended.
        seconds: Wall-clock time of `total`, `decode`, `geometry` and `fit`.
        gaussians: Size of the final population.
        notes: Findings for the user: guesses, fallbacks, doubts.
        settings: The settings used, as plain values.
        seed: Seed of every random draw.
        verdict: `scene` or `decode` if the delivered views are almost entirely those, otherwise `refined`: a
            combination with the mean of the fits' views and their decoded residual.
        heldout_rms: The residual of each on the held-out pixels, in the measurement's unit; None if none were held out.
        geometry: Of the first path.
        ensemble: Of the fits.
        disagreement: Root-mean-square difference of the fits' views from their mean per pixel, [N, H, W] float32, in
            full scales: larger where the views are less reliable; None with one fit.
        brightness: Factors of the shot's weights for coding these views, N numbers; None if the weights are unchanged.
        light: Of the views' brightness; None if it could not be estimated.
        mask_moments: Of the moments with which each mask was fitted; None if one per mask was enough.
        exposed_views: The mean of what the camera saw while each mask was shown, if `views` show the middle of it;
            otherwise None.
        registration: Of masks, black level and unit.
        registered: The corrected measurement, which all later steps used, if anything was corrected;
            `residual`, `heldout_rms` and `predicted_measurement` are in its unit.
        motion: Of what moves.
        race: What became of each hypothesis, in the order of entering.
        displacement: Displacement of the scene point at each pixel over the exposure, seen from the camera of the
            middle view, [H, W, 2] float32 as (x, y) in px; None if nothing moves.
        uncertainty: Standard errors of views, depth and poses; None if they were not asked for.
        exposures: Of each of several exposures, whose views follow one another; empty for one.
        device: What rendered: "cpu", or a CUDA device with its model.
    """

    views: F32
    scene_views: F32
    depth: F32 | None
    world_to_camera: F64
    intrinsics: F64
    decode: F32
    predicted_measurement: F32
    curve: Sequence[CurvePoint]
    stopped: Finding
    seconds: Mapping[str, float]
    gaussians: int
    notes: Sequence[Finding]
    settings: Mapping[str, Any]
    seed: int
    verdict: Verdict
    heldout_rms: Mapping[Verdict, float | None]
    geometry: GeometrySection | None = None
    ensemble: EnsembleSection | None = None
    disagreement: F32 | None = None
    distortion: F64 | None = None
    brightness: Sequence[float] | None = None
    light: LightSection | None = None
    mask_moments: MaskMomentsSection | None = None
    exposed_views: F32 | None = None
    registration: RegistrationSection | None = None
    registered: Shot | None = None
    depth_spread: F32 | None = None
    depth_confidence: F32 | None = None
    motion: MotionSection | None = None
    race: Sequence[RaceEntry] = ()
    displacement: F32 | None = None
    uncertainty: Uncertainty | None = None
    exposures: Sequence[ExposureSection] = ()
    device: str = "cpu"

    def check(self) -> "RunResult":
        """Return self if all parts fit together and contain only finite numbers.

        Raises:
            InputError: Shapes disagree, a time is missing, or the verdict is unknown.
            NumericsError: An array holds NaN or infinity.
        """
        if self.views.ndim != 4 or self.views.shape[3] not in (1, 3):
            raise InputError(f"views have shape {list(self.views.shape)}", allowed="[N, H, W, C] with C = 1 or 3")
        n, height, width, _ = self.views.shape
        wanted: dict[str, tuple[NDArray[Any] | None, tuple[int, ...]]] = {
            "views": (self.views, self.views.shape),
            "exposed_views": (self.exposed_views, self.views.shape),
            "scene_views": (self.scene_views, self.views.shape),
            "depth": (self.depth, (n, height, width)),
            "depth_spread": (self.depth_spread, (n, height, width)),
            "depth_confidence": (self.depth_confidence, (n, height, width)),
            "disagreement": (self.disagreement, (n, height, width)),
            "displacement": (self.displacement, (height, width, 2)),
            "world_to_camera": (self.world_to_camera, (n, 4, 4)),
            "decode": (self.decode, self.views.shape),
            "predicted_measurement": (
                self.predicted_measurement,
                (height, width, *self.predicted_measurement.shape[2:]),
            ),
        }
        for name, (array, shape) in wanted.items():
            if array is not None:
                _check_array(name, array, shape)
        if self.uncertainty is not None:
            self.uncertainty.check((n, height, width))
        check_intrinsics(self.intrinsics)
        if self.distortion is not None:
            check_distortion(self.distortion, self.intrinsics, (height, width))
        missing = [key for key in SECONDS_KEYS if key not in self.seconds]
        if missing:
            raise InputError(f"the times of {', '.join(missing)} are missing", allowed=", ".join(SECONDS_KEYS))
        if self.verdict not in VERDICTS:
            raise InputError(f"verdict {self.verdict!r}", allowed=" or ".join(VERDICTS))
        return self


def _check_array(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InputError(f"{name} of the result has shape {list(array.shape)}", allowed=str(list(shape)))
    # One view at a time: those of many exposures are large.
    if not all(np.isfinite(part).all() for part in array):
        raise NumericsError(
            f"{name} of the result holds NaN or infinity",
            allowed="finite numbers",
            remedy="report this run with its shot file: a fit must roll back before it gets here",
        )
