"""The geometry tables of a scene file: one per kind, each of which can build its scene.

Here: the tables and their keys. Not here: the file around them (`files`), the building (the modules named here).
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from gs2ci.core.config import ConfigTable
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene, camera_looking_ahead
from gs2ci_sims.scenes.ball import ball
from gs2ci_sims.scenes.boxes import boxes, moving_box
from gs2ci_sims.scenes.corridor import corridor
from gs2ci_sims.scenes.meshes import blocks, mesh_from_file, scene_from_mesh
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.ply import scene_from_ply
from gs2ci_sims.scenes.rgbd import motorcycle
from gs2ci_sims.scenes.stage import SuggestedCamera
from gs2ci_sims.scenes.textureless import textureless
from gs2ci_sims.scenes.thicket import thicket

Vector = tuple[float, float, float]
Row = tuple[float, float, float, float]


class Procedural(ConfigTable):
    """The common settings of all procedural scenes."""

    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of every random choice."""

    def generator(self) -> np.random.Generator:
        """Return a new generator for this seed."""
        return np.random.default_rng(self.seed)


class Planes(Procedural):
    """Tilted rectangles in front of a backdrop."""

    kind: Literal["planes"]
    depths: tuple[float, ...] = (2.0, 2.7, 3.5)
    backdrop: float = 5.0
    boxes: Annotated[int, Field(ge=0)] = 1

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return planes(
            self.generator(),
            frame.size,
            depths=self.depths,
            backdrop=self.backdrop,
            boxes=self.boxes,
            field_of_view_deg=frame.field_of_view_deg,
        )


class Boxes(Procedural):
    """Boxes on a floor."""

    kind: Literal["boxes"]
    count: int = 7
    backdrop: float = 6.0

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return boxes(self.generator(), frame, count=self.count, backdrop=self.backdrop)


class MovingBox(Procedural):
    """A box in the air, for the effect `object_motion` to move."""

    kind: Literal["moving_box"]
    centre: Vector = (-0.4, -0.25, 3.0)
    radius: float = 0.45
    count: int = 3
    backdrop: float = 6.0

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return moving_box(
            self.generator(), frame, centre=self.centre, radius=self.radius, count=self.count, backdrop=self.backdrop
        )


class Thicket(Procedural):
    """Thin stems and twigs."""

    kind: Literal["thicket"]
    stems: int = 60
    twigs: int = 3
    width_px: tuple[float, float] = (1.2, 5.0)
    near: float = 2.0
    backdrop: float = 6.0

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return thicket(
            self.generator(),
            frame,
            stems=self.stems,
            twigs=self.twigs,
            width_px=self.width_px,
            near=self.near,
            backdrop=self.backdrop,
        )


class Ball(Procedural):
    """A shiny ball."""

    kind: Literal["ball"]
    radius: float = 0.75
    depth: float = 4.0
    shine: float = 0.8
    exponent: float = 8.0
    backdrop: float = 6.0

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return ball(
            self.generator(),
            frame,
            radius=self.radius,
            depth=self.depth,
            shine=self.shine,
            exponent=self.exponent,
            backdrop=self.backdrop,
        )


class Corridor(Procedural):
    """A deep corridor."""

    kind: Literal["corridor"]
    half_width: float = 1.0
    half_height: float = 0.8
    length: float = 30.0

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return corridor(
            self.generator(),
            frame,
            half_width=self.half_width,
            half_height=self.half_height,
            length=self.length,
        )


class Textureless(Procedural):
    """A small textured box in front of plain walls."""

    kind: Literal["textureless"]
    edge: float = 0.5
    depth: float = 4.0
    backdrop: float = 6.0

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return textureless(self.generator(), frame, edge=self.edge, depth=self.depth, backdrop=self.backdrop)


class Photograph(ConfigTable):
    """A photograph with measured disparity. It has its own lens: the field of view cannot be chosen."""

    kind: Literal["photograph"]
    which: Literal["motorcycle"]

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera of this image size."""
        return _PHOTOGRAPHS[self.which](frame.size)


class GaussianFile(ConfigTable):
    """Gaussians from a PLY file of gs2ci, gsplat or the original 3DGS program."""

    kind: Literal["ply"]
    file: Path
    """Relative to the folder of the scene file."""
    world_to_camera: tuple[Row, Row, Row, Row] | None = None
    """Pose of the camera, row by row; without it, the origin, looking along z."""

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        pose = None if self.world_to_camera is None else np.array(self.world_to_camera)
        intrinsics = camera_looking_ahead(frame.size, frame.field_of_view_deg)
        return scene_from_ply(folder / self.file, frame.size, intrinsics=intrinsics, world_to_camera=pose)


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

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        return blocks(
            self.generator(),
            frame,
            count=self.count,
            balls=self.balls,
            backdrop=self.backdrop,
            shine=self.shine,
            exponent=self.exponent,
            light=self.light,
        )


class MeshFile(ConfigTable):
    """Textured triangles from an OBJ, GLB, PLY or STL file."""

    kind: Literal["mesh"]
    file: Path
    """Relative to the folder of the scene file."""
    world_to_camera: tuple[Row, Row, Row, Row] | None = None
    """Pose of the camera, row by row; without it, the origin, looking along z."""

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        pose = None if self.world_to_camera is None else np.array(self.world_to_camera)
        mesh = mesh_from_file(folder / self.file)
        return scene_from_mesh(self.file.stem, mesh, frame.size, frame.intrinsics, pose)


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

_PHOTOGRAPHS: dict[str, Callable[[tuple[int, int]], Scene]] = {"motorcycle": motorcycle}


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
