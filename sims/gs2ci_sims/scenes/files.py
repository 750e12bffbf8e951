"""Scene files: short TOML files that name a scene's geometry, its light and the rig's path; `load_scene` reads them.

The scene files of the simulator are in `library`, and can be given by name. Not here: the tables of geometry
(`geometry`), the rig (`gs2ci_sims.rig`).
"""

from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

from pydantic import Field, ValidationError

from gs2ci.core.config import ConfigTable, read_settings
from gs2ci.core.errors import InputError
from gs2ci.core.plugins import allowed, load
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.rig import Light
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.geometry import Geometry, Vector, refuse_field_of_view
from gs2ci_sims.scenes.stage import SuggestedCamera

Table = TypeVar("Table", bound=ConfigTable)

SCENE_GROUP: Final = "gs2ci.scenes"
LIBRARY: Final = Path(__file__).parent / "library"


class CameraTable(ConfigTable):
    """[camera]: the image."""

    height: Annotated[int, Field(ge=1)] = 272
    width: Annotated[int, Field(ge=1)] = 400
    field_of_view_deg: Annotated[float | None, Field(gt=0, lt=180)] = None
    """Horizontal field of view; the default is 50, and for a photograph its own."""


class LightTable(ConfigTable):
    """[light]: the brightness."""

    full_scale_photons: Annotated[float, Field(ge=0)] = 4180.0
    """Photons in a pixel from radiance 1 through one open mask."""


class PathTable(ConfigTable):
    """[path]: the motion of the camera during the exposure. Give `parallax_px` or `travel`."""

    views: Annotated[int, Field(ge=1)] = 8
    """Masks during the exposure."""
    parallax_px: Annotated[float | None, Field(ge=0)] = None
    """Total shift between the nearest and the farthest depth."""
    direction: Vector = (1.0, 0.3, 0.1)
    """Direction of the motion for `parallax_px`: right, down, ahead."""
    travel: Vector | None = None
    """Total motion of the camera, scene units: right, down, ahead."""
    wobble_deg: Annotated[float, Field(ge=0)] = 0.05
    """Amplitude of the stage's pitch, yaw and roll."""


class ObjectTable(ConfigTable):
    """[object_motion]: the moving object, for the effect `object_motion`."""

    centre: Vector
    """Centre of the sphere whose Gaussians move, in the middle of the exposure, scene units."""
    radius: Annotated[float, Field(gt=0)]
    travel: Vector
    """Total motion during the exposure, scene units."""


class SceneFile(ConfigTable):
    """A scene file."""

    name: str
    geometry: Geometry
    camera: CameraTable = CameraTable()
    light: LightTable = LightTable()
    path: PathTable = PathTable(parallax_px=12.0)
    object_motion: ObjectTable | None = None


@dataclass(frozen=True)
class LoadedScene:
    """A scene with the light and the motion that its file states.

    Args:
        scene: The scene with its suggested camera and its true depth.
        light: Its brightness.
        views: Masks during the exposure.
        file: The whole scene file.
    """

    scene: Scene
    light: Light
    views: int
    file: SceneFile

    def path(self, exposure_s: float) -> StageMove:
        """Return the camera's path for an exposure of this length.

        Raises:
            InputError: The exposure has no length, or the scene has no depth for the requested parallax.
        """
        table = self.file.path
        if table.travel is None:
            return stage_move_for_parallax(
                self.scene,
                table.parallax_px or 0.0,
                exposure_s,
                direction=table.direction,
                wobble_deg=table.wobble_deg,
            )
        velocity = _per_second(table.travel, exposure_s)
        return StageMove(velocity, table.wobble_deg, 4 / (3 * exposure_s), self.scene.world_to_camera)

    def object_motion(self, exposure_s: float) -> ObjectMotion | None:
        """Return the motion of the object during an exposure of this length; None if the file has none.

        Raises:
            InputError: The exposure has no length.
        """
        table = self.file.object_motion
        if table is None:
            return None
        return ObjectMotion(table.centre, table.radius, _per_second(table.travel, exposure_s))


def scene_names() -> tuple[str, ...]:
    """Return the names of the scenes that come with the simulator."""
    return tuple(sorted(path.stem for path in LIBRARY.glob("*.toml")))


def load_scene(
    which: str | Path,
    *,
    size: tuple[int, int] | None = None,
    field_of_view_deg: float | None = None,
    views: int | None = None,
    parallax_px: float | None = None,
) -> LoadedScene:
    """Read a scene file and build its scene.

    Args:
        which: A name from `scene_names` or of a plug-in, whose object is a path; or the path of a .toml file.
        size: Height and width instead of the file's, px.
        field_of_view_deg: Horizontal field of view instead of the file's.
        views: Masks instead of the file's.
        parallax_px: Motion instead of the file's.

    Raises:
        InputError: The scene is unknown, the file is invalid (the message names the nearest known key), or the scene
            cannot be built.
    """
    path = _path(which)
    file = read_settings(path, SceneFile)
    camera = file.camera.model_dump()
    if size is not None:
        camera |= {"height": size[0], "width": size[1]}
    if field_of_view_deg is not None:
        camera["field_of_view_deg"] = field_of_view_deg
    move = file.path.model_dump()
    if views is not None:
        move["views"] = views
    if parallax_px is not None:
        move |= {"parallax_px": parallax_px, "travel": None}
    file = file.model_copy(update={"camera": _checked(CameraTable, camera), "path": _checked(PathTable, move)})
    if (file.path.parallax_px is None) == (file.path.travel is None):
        raise InputError(f"{path}: [path] needs one of parallax_px and travel", allowed="exactly one of the two")
    return LoadedScene(_built(file, path.parent), Light(file.light.full_scale_photons), file.path.views, file)


def _built(file: SceneFile, folder: Path) -> Scene:
    if file.camera.field_of_view_deg is not None:
        refuse_field_of_view(file.geometry)
    frame = SuggestedCamera((file.camera.height, file.camera.width), file.camera.field_of_view_deg or 50.0)
    return replace(file.geometry.build(frame, folder), name=file.name)


def _path(which: str | Path) -> Path:
    if str(which).endswith(".toml"):
        return Path(which)
    names = scene_names()
    plugged = None if str(which) in names else load(SCENE_GROUP, str(which))
    if plugged is not None:
        return Path(plugged)
    if str(which) not in names:
        near = get_close_matches(str(which), names, n=1, cutoff=0.5)
        raise InputError(
            f"no scene {str(which)!r}" + (f"; did you mean {near[0]!r}?" if near else ""),
            allowed=f"{allowed(SCENE_GROUP, names)}, or the path of a .toml file",
        )
    return LIBRARY / f"{which}.toml"


def _checked(model: type[Table], values: dict[str, Any]) -> Table:
    try:
        return model.model_validate(values)
    except ValidationError as error:
        wrong = "; ".join(f"{problem['loc'][0]} = {problem['input']!r}: {problem['msg']}" for problem in error.errors())
        raise InputError(wrong, remedy="mend what is given instead of the scene file's") from error


def _per_second(travel: Vector, exposure_s: float) -> Vector:
    if not exposure_s > 0:
        raise InputError(f"an exposure of {exposure_s} s", allowed="more than 0")
    x, y, z = travel
    return x / exposure_s, y / exposure_s, z / exposure_s
