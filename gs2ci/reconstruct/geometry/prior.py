"""What a source of first poses and depth is given and what it returns.

Here: the interface, and the step from a source that may fail to a geometry that is always there. Not here: the
sources (`sources`, `vggt`), which of them to take (`choose`).
"""

from dataclasses import dataclass, field, replace
from typing import Protocol

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import GeometryError, NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings, initialise
from gs2ci.reconstruct.measurement.lens import Lens, straightened


@dataclass(frozen=True)
class Request:
    """What is known before there is any geometry.

    Args:
        shot: The measurement as far as it may be seen, with what the file says of camera and stage.
        views: Proxy views to look at, [N, H, W, C] float32 in [0, 1], in the order of exposure; behind a lens that
            distorts, as its canvas shows them.
        settings: Of tracks, motion, depth, and the criteria of validity.
        lens: The shot's, unless it is a pinhole.
    """

    shot: Shot
    views: F32
    settings: GeometrySettings = field(default_factory=GeometrySettings)
    lens: Lens | None = None

    @classmethod
    def of(cls, shot: Shot, views: F32, settings: GeometrySettings, lens: Lens | None) -> "Request":
        """Ask about views, [N, H, W, C], as the sensor sees them."""
        return cls(shot, straightened(views, lens), settings, lens)

    @property
    def intrinsics(self) -> F64 | None:
        """Get the camera matrix of the views, [3, 3], if it is known."""
        return self.shot.intrinsics if self.lens is None else self.lens.canvas_intrinsics

    @property
    def size(self) -> tuple[int, int]:
        """Get height and width of the views, px."""
        return int(self.views.shape[1]), int(self.views.shape[2])

    @property
    def seen(self) -> Bool | None:
        """Get which pixels of the views the sensor sees, [H, W]; None: all."""
        return None if self.lens is None else self.lens.seen


class GeometryPrior(Protocol):
    """Finds the camera path and the depth that a fit begins with."""

    @property
    def name(self) -> str:
        """Get the name that reports call it by."""

    def __call__(self, request: Request, progress: Progress) -> Geometry:
        """Return a geometry; where it cannot be believed, its verdict and notes say so.

        Raises:
            InputError: What the user named does not fit this shot.
            GeometryError: What it found contradicts the views.
            NumericsError: A model failed, or its answer is not finite.
        """


def from_tracks(request: Request, progress: Progress) -> Geometry:
    """Find the geometry in the views themselves: what every other source falls back to."""
    return initialise(request.views, request.intrinsics, request.settings, progress, seen=request.seen)


def find_geometry(prior: GeometryPrior, request: Request, progress: Progress) -> Geometry:
    """Ask a source; where it fails, take what the tracks give, and say why.

    Raises:
        InputError: What the user named does not fit this shot.
    """
    try:
        return prior(request, progress)
    except (GeometryError, NumericsError) as error:
        note = finding(Code.SOURCE_FAILED, source=prior.name, problem=error.problem)
        progress.say(note.sentence)
        found = from_tracks(request, progress)
        return replace(found, notes=(note, *found.notes))
