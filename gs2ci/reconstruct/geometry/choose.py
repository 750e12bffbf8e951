"""From the name of a geometry prior to the prior, and the one that chooses by evidence.

Here: the names, and `auto`. Not here: the sources themselves. For the pipeline and the commands.

`auto` asks every source that this shot and this machine have: the tracks always, the stage if it reported poses, VGGT
if the user has added it. A source counts only if its verdict is full. Of those, the measurement decides (`evidence`);
the tracks stand unless another leaves clearly less unexplained.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.geometry.evidence import unexplained
from gs2ci.reconstruct.geometry.hierarchy import FromVggt
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import GeometryPrior, Request
from gs2ci.reconstruct.geometry.sources import FromFile, FromStage, FromTracks
from gs2ci.reconstruct.onnx_models import find_model, known_model

_FILE: Final = "file:"
_VGGT: Final = "vggt:"
# Another source must leave this share of what the tracks leave, or less: below it, the number is decode noise.
_CLEARLY: Final = 0.99


def load_geometry_prior(name: str) -> GeometryPrior:
    """Load a geometry prior.

    Args:
        name: "tracks"; "stage"; "auto"; "file:PATH" (a COLMAP model's folder or a transforms.json); "vggt", the model
            added under that name; or "vggt:FILE".

    Raises:
        InputError: No such name, no such file, or a model file that cannot be used.
        StorageError: The list of added models cannot be read.
    """
    if name == "tracks":
        return FromTracks()
    if name == "stage":
        return FromStage()
    if name == "auto":
        return Auto()
    if name.startswith(_FILE):
        path = Path(name.removeprefix(_FILE))
        if not path.exists():
            raise InputError(f"no camera file {path}", allowed="a COLMAP model's folder or a transforms.json")
        return FromFile(path)
    if name == "vggt":
        return FromVggt(find_model("vggt"))
    if name.startswith(_VGGT):
        return FromVggt(Path(name.removeprefix(_VGGT)))
    raise InputError(f"geometry {name!r}", allowed="tracks, stage, auto, file:PATH, vggt or vggt:FILE")


@dataclass(frozen=True)
class Auto:
    """Asks all sources there are, and lets the measurement choose."""

    name: str = "auto"

    def __call__(self, request: Request, progress: Progress) -> Geometry:
        """Find the geometry; see `GeometryPrior`."""
        stands = FromTracks()(request, progress)
        left = unexplained(request.shot, request.views, stands, request.lens)
        said = [f"tracks {stands.verdict}, {left:.4f} unexplained"]
        for name in _others(request):
            try:
                found = load_geometry_prior(name)(request, progress)
            except Gs2ciError as error:
                said.append(f"{name} failed ({error.problem})")
                continue
            others = unexplained(request.shot, request.views, found, request.lens)
            said.append(f"{name} {found.verdict}, {others:.4f} unexplained")
            if found.verdict == "full" and (stands.verdict != "full" or others < _CLEARLY * left):
                stands, left = found, others
        note = f"Geometry from {stands.source}: {'; '.join(said)}."
        progress.say(note)
        return replace(stands, notes=(note, *stands.notes))


def _others(request: Request) -> list[str]:
    """Name the sources beside the tracks that can be asked."""
    stage = ["stage"] if request.shot.telemetry_world_to_camera is not None else []
    return stage + (["vggt"] if known_model("vggt") is not None else [])
