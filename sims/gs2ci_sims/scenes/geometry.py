"""The geometry tables of a scene file: one per kind, each of which can build its scene.

Here: the tables and their keys. Not here: the file around them (`files`), the building (the modules named here).
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci.core.config import ConfigTable
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.ball import ball
from gs2ci_sims.scenes.meshes import blocks, mesh_from_file, scene_from_mesh
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.ply import scene_from_ply
from gs2ci_sims.scenes.rgbd import motorcycle
from gs2ci_sims.scenes.rooms import boxes, corridor, moving_box, textureless, thicket
from gs2ci_sims.scenes.stage import SuggestedCamera

Vector = tuple[float, float, float]
Row = tuple[float, float, float, float]


class Procedural(ConfigTable):
    """The common settings of all procedural scenes: the other keys are arguments of the function in `_PROCEDURES`."""

    kind: str
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of every random choice."""

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        settings = self.model_dump(exclude={"kind", "seed"})
        return _PROCEDURES[self.kind](np.random.default_rng(self.seed), frame, **settings)


class Planes(Procedural):
    """Tilted rectangles in front of a backdrop."""

    kind: Literal["planes"]
    depths: tuple[float, ...] = (2.0, 2.7, 3.5)
    backdrop: float = 5.0
    boxes: Annotated[int, Field(ge=0)] = 1


class Boxes(Procedural):
    """Boxes on a floor."""

    kind: Literal["boxes"]
    count: int = 7
    backdrop: float = 6.0


class MovingBox(Procedural):
    """A box in the air, for the effect `object_motion` to move."""

    kind: Literal["moving_box"]
    centre: Vector = (-0.4, -0.25, 3.0)
    radius: float = 0.45
    count: int = 3
    backdrop: float = 6.0


class Thicket(Procedural):
    """Thin stems and twigs."""

    kind: Literal["thicket"]
    stems: int = 60
    twigs: int = 3
    width_px: tuple[float, float] = (1.2, 5.0)
    near: float = 2.0
    backdrop: float = 6.0


class Ball(Procedural):
    """A shiny ball."""

    kind: Literal["ball"]
    radius: float = 0.75
    depth: float = 4.0
    shine: float = 0.8
    exponent: float = 8.0
    backdrop: float = 6.0


class Corridor(Procedural):
    """A deep corridor."""

    kind: Literal["corridor"]
    half_width: float = 1.0
    half_height: float = 0.8
    length: float = 30.0


class Textureless(Procedural):
    """A small textured box in front of plain walls."""

    kind: Literal["textureless"]
    edge: float = 0.5
    depth: float = 4.0
    backdrop: float = 6.0


class Photograph(ConfigTable):
    """A photograph with measured disparity. It has its own lens: the field of view cannot be chosen."""

    kind: Literal["photograph"]
    which: Literal["motorcycle"]

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera of this image size."""
        return motorcycle(frame.size)


class SceneInFile(ConfigTable):
    """The common settings of all scenes in files."""

    file: Path
    """Relative to the folder of the scene file."""
    world_to_camera: tuple[Row, Row, Row, Row] | None = None
    """Pose of the camera, row by row; without it, the origin, looking along z."""

    @property
    def pose(self) -> F64 | None:
        """Get the pose, [4, 4]."""
        return None if self.world_to_camera is None else np.array(self.world_to_camera)


class GaussianFile(SceneInFile):
    """Gaussians from a PLY file of gs2ci, gsplat or the original 3DGS program."""

    kind: Literal["ply"]

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return scene_from_ply(folder / self.file, frame.size, intrinsics=frame.intrinsics, world_to_camera=self.pose)


class Blocks(Procedural):
    """Boxes and balls of textured triangles."""

    kind: Literal["blocks"]
    count: int = 6
    balls: int = 3
    backdrop: float = 6.0
    shine: float = 0.0
    """Radiance of highlights at their peak; 0 has none."""
    exponent: float = 30.0
    light: Vector = (-0.4, -0.8, -0.5)
    """Direction towards the light of the highlights: right, down, ahead."""


class MeshFile(SceneInFile):
    """Textured triangles from an OBJ, GLB, PLY or STL file."""

    kind: Literal["mesh"]

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        mesh = mesh_from_file(folder / self.file)
        return scene_from_mesh(self.file.stem, mesh, frame.size, frame.intrinsics, self.pose)


Geometry = Annotated[
    Planes
    | Boxes
    | MovingBox
    | Thicket
    | Ball
    | Corridor
    | Textureless
    | Blocks
    | Photograph
    | GaussianFile
    | MeshFile,
    Field(discriminator="kind"),
]

_PROCEDURES: Final[dict[str, Callable[..., Scene]]] = {
    "planes": lambda rng, frame, **settings: planes(
        rng, frame.size, field_of_view_deg=frame.field_of_view_deg, **settings
    ),
    "boxes": boxes,
    "moving_box": moving_box,
    "thicket": thicket,
    "ball": ball,
    "corridor": corridor,
    "textureless": textureless,
    "blocks": blocks,
}


def refuse_field_of_view(geometry: Geometry) -> None:
    """Accept a chosen field of view.

    Raises:
        InputError: The geometry is a photograph.
    """
    if isinstance(geometry, Photograph):
        raise InputError(
            f"a field of view for the photograph {geometry.which!r}",
            allowed="the photograph's own",
            remedy="leave field_of_view_deg out",
        )
