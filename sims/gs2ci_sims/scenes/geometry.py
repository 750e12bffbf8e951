"""The geometry tables of a scene file: one per kind, each of which can build its scene.

Here: the tables; keys of a procedural scene are the keyword arguments of its function. Not here: the file around them
(`files`), the building (the modules named here).
"""

from collections.abc import Callable
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Union

import numpy as np
from pydantic import Field, create_model

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


_PROCEDURES: Final[dict[str, Callable[..., Scene]]] = {
    "planes": planes,
    "boxes": boxes,
    "moving_box": moving_box,
    "thicket": thicket,
    "ball": ball,
    "corridor": corridor,
    "textureless": textureless,
    "blocks": blocks,
}


class Procedural(ConfigTable):
    """The settings of a procedural scene: besides these, the keyword arguments of its function in `_PROCEDURES`."""

    kind: str
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of every random choice."""

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        make, rng = _PROCEDURES[self.kind], np.random.default_rng(self.seed)
        settings = self.model_dump(exclude={"kind", "seed"})
        if make is planes:
            return planes(rng, frame.size, field_of_view_deg=frame.field_of_view_deg, **settings)
        return make(rng, frame, **settings)


def _table_of(kind: str) -> type[Procedural]:
    keys: dict[str, Any] = {
        name: (argument.annotation, argument.default)
        for name, argument in signature(_PROCEDURES[kind]).parameters.items()
        if argument.kind is argument.KEYWORD_ONLY and name != "field_of_view_deg"  # which is the camera's
    }
    # A class that stands in no file has no docstrings there, for which pydantic would search through all modules.
    unsought = {"use_attribute_docstrings": False}
    return create_model(kind, __base__=Procedural, __cls_kwargs__=unsought, **keys | {"kind": (Literal[kind], ...)})


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


class MeshFile(SceneInFile):
    """Textured triangles from an OBJ, GLB, PLY or STL file."""

    kind: Literal["mesh"]

    def build(self, frame: SuggestedCamera, folder: Path) -> Scene:
        """Build the scene for a camera."""
        mesh = mesh_from_file(folder / self.file)
        return scene_from_mesh(self.file.stem, mesh, frame.size, frame.intrinsics, self.pose)


if TYPE_CHECKING:
    Geometry = Procedural | Photograph | GaussianFile | MeshFile
else:
    _TABLES = (*map(_table_of, _PROCEDURES), Photograph, GaussianFile, MeshFile)
    Geometry = Annotated[Union[_TABLES], Field(discriminator="kind")]  # noqa: UP007  made of a tuple


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
