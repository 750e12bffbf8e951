"""The interface of geometry priors, the sources of first poses and depth.

Here: the interface, and the call of a source with its fallback to tracks. Not here: the sources (`sources`, `vggt`),
the choice between them (`choose`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

from gs2ci.core.arrays import F32, F64, Bool, Size
from gs2ci.core.errors import GeometryError, NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.plugins import PluginError
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings, initialise
from gs2ci.reconstruct.measurement.lens import Lens, straightened


@dataclass(frozen=True)
class Request:
    """The input of a geometry prior.

    Args:
        shot: The measurement without its held-out pixels, with the file's data on camera and stage.
        views: Proxy views, [N, H, W, C] float32 in [0, 1], in the order of exposure; with a lens that distorts,
            straightened on its canvas.
        settings: Of tracks, motion, depth, and the criteria of validity.
        lens: The shot's, unless it is a pinhole.
    """

    shot: Shot
    views: F32
    settings: GeometrySettings = field(default_factory=GeometrySettings)
    lens: Lens | None = None

    @classmethod
    def of(cls, shot: Shot, views: F32, settings: GeometrySettings, lens: Lens | None) -> "Request":
        """Make a request from views, [N, H, W, C], as the sensor sees them."""
        return cls(shot, straightened(views, lens), settings, lens)

    @property
    def intrinsics(self) -> F64 | None:
        """Get the camera matrix of the views, [3, 3], if it is known."""
        return self.shot.intrinsics if self.lens is None else self.lens.canvas_intrinsics

    @property
    def size(self) -> Size:
        """Get height and width of the views, px."""
        return int(self.views.shape[1]), int(self.views.shape[2])

    @property
    def seen(self) -> Bool | None:
        """Get which pixels of the views the sensor sees, [H, W]; None: all."""
        return None if self.lens is None else self.lens.seen


class GeometryPrior(Protocol):
    """Estimates the camera path and the depth from which a fit starts."""

    @property
    def name(self) -> str:
        """Get its name in reports."""

    def __call__(self, request: Request, progress: Progress) -> Geometry:
        """Return a geometry; if it is unreliable, its verdict and notes say so.

        Raises:
            InputError: The source that the user named does not fit this shot.
            GeometryError: Its geometry contradicts the views.
            NumericsError: A model failed, or its answer is not finite.
        """


@dataclass(frozen=True)
class Source:
    """A geometry prior of a name and a function."""

    name: str
    find: Callable[[Request, Progress], Geometry]

    def __call__(self, request: Request, progress: Progress) -> Geometry:
        """Find the geometry; see `GeometryPrior`."""
        return self.find(request, progress)


def from_tracks(request: Request, progress: Progress) -> Geometry:
    """Estimate the geometry from tracks in the views; every other source falls back to this."""
    return initialise(request.views, request.intrinsics, request.settings, progress, seen=request.seen)


def find_geometry(prior: GeometryPrior, request: Request, progress: Progress) -> Geometry:
    """Call a source; if it fails, return the geometry of the tracks with a note that says why.

    Raises:
        InputError: The source that the user named does not fit this shot.
    """
    try:
        return prior(request, progress)
    except (GeometryError, NumericsError, PluginError) as error:
        note = finding(Code.SOURCE_FAILED, source=prior.name, problem=error.problem)
        progress.say(note.sentence)
        found = from_tracks(request, progress)
        return replace(found, notes=(note, *found.notes))
