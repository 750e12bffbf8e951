"""Parts of a run as files for other programs: `export`, `mesh`.

Here: the list of parts, and what of a run each holds. Not here: the formats (`gs2ci.evaluate.exports`,
`gs2ci.render`), what may be replaced by an export (`gs2ci.api.places`).
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from gs2ci.api.options import check_choice
from gs2ci.api.places import check_free, write_to
from gs2ci.api.runs import Run, open_run
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress, Silent

if TYPE_CHECKING:
    from gs2ci.core.arrays import F32
    from gs2ci.evaluate.points import Cameras
    from gs2ci.render.gaussians import Gaussians

ExportFormat = Literal[
    "ply", "spz", "sog", "glb", "colmap", "nerfstudio", "instant-ngp", "depth-png", "depth-exr", "nexus", "gif", "mp4"
]


def export(
    run: Run | str | Path,
    to: ExportFormat,
    path: str | Path | None = None,
    *,
    overwrite: bool = False,
    as_fitted: bool = False,
    f_rest: bool = False,
    spz_version: Literal[2, 3] = 3,
    progress: Progress | None = None,
) -> Path:
    """Write a part of a saved run for another program.

    Args:
        run: A run that was saved, or its folder.
        to: ply, spz, sog and glb contain the Gaussians, fitted to what viewers do; colmap is a folder with sparse model
            and images, nerfstudio and instant-ngp are folders with transforms.json and images; depth-png (16 bit) and
            depth-exr are folders of depth maps; nexus is an HDF5 file with views, depth and cameras under the names of
            the NeXus standard; gif and mp4 show a short orbit of the scene.
        path: The file or folder to write; by default one with the format's usual name in the current folder.
        overwrite: Replace an existing file, or a folder that is an earlier export to the same format, as a whole.
            Nothing inside the run folder is replaced.
        as_fitted: Write the Gaussians exactly as the reconstruction fitted them, and not as viewers show them best.
        f_rest: In a PLY file, write all coefficients of colours that depend on direction, even if all are zero: viewers
            of SIBR's kind open no file without them.
        spz_version: Of the SPZ format: older readers open version 2 alone, whose rotations are less exact.
        progress: Receives sentences on what was changed for the format; None drops them.

    Returns:
        The path.

    Raises:
        InputError: The format is unknown, the path has the ending of another, the run has no such part, a part is
            damaged, or a package is missing.
        StorageError: The output exists already or may not be replaced, or writing fails.

    Example:
        >>> gs2ci.export("run", "spz").name, gs2ci.export("run", "depth-png", "maps").is_dir()
        ('scene.spz', True)
    """
    check_choice("--to", to, get_args(ExportFormat))
    opened = run if isinstance(run, Run) else open_run(run)
    if opened.folder is None:
        raise InputError("the run has no folder yet", remedy="call save() first")
    form = FORMATS[to]
    target = Path(form.name if path is None else path)
    _check_ending(f"--to {to}", target, form.name)
    check_free(target, opened, form.files, overwrite=overwrite)
    told = Silent() if progress is None else progress
    asked = _Asked(opened, opened.folder, as_fitted=as_fitted, f_rest=f_rest, spz_version=spz_version, say=told.say)
    return write_to(target, form.writer(asked))


def _check_ending(what: str, target: Path, usual: str) -> None:
    """Refuse a name with the ending of another format, by which other programs would take the file for one."""
    endings = {Path(other.name).suffix for other in FORMATS.values()} | _UNWRITTEN
    if target.suffix.lower() in endings - {"", Path(usual).suffix}:
        raise InputError(f"{what} into {target}", allowed=f"a name like {usual}", remedy="change the name after -o")


# Endings of formats of meshes and Gaussians that nothing here writes.
_UNWRITTEN: Final = {".obj", ".stl", ".off", ".gltf", ".splat", ".ksplat"}
# Where Gaussians far away leave a format's grid too coarse for the rest, they are brought to so many typical distances,
# the first that does: a whole parallax of 20 px is a fiftieth of a pixel at the first, and a fifth at the second.
_SPZ_DISTANCES: Final = (1000.0, 100.0)
# Lengths of units that are known.
_METRES: Final = {"mm": 1e-3}


def mesh(
    run: Run | str | Path,
    path: str | Path = "mesh.ply",
    *,
    voxels: int = 160,
    least_share: float = 0.01,
    overwrite: bool = False,
) -> Path:
    """Write a mesh of the surfaces in a run's depth maps, as PLY with a colour per vertex, and its standard error.

    The mesh is closed only if the views see a surface from all sides; otherwise it ends where they see no more. If
    things move, it shows what the middle view sees.

    Args:
        run: A run that was saved, or its folder.
        path: The file to write.
        voxels: Number along the longest side of the visible scene: more are finer; memory grows with their cube.
        least_share: Leave out pieces that hang together with nothing else and whose area is less than this share of the
            largest piece's; 0 keeps all.
        overwrite: Replace an existing file, unless it lies in the run folder.

    Returns:
        The path.

    Raises:
        InputError: The run has no reliable depth, or no camera path, `voxels` is out of bounds, or the path has the
            ending of another format.
        StorageError: The output exists already or may not be replaced, or writing fails.

    Example:
        >>> gs2ci.mesh("run", voxels=32).name
        'mesh.ply'
    """
    from gs2ci.evaluate.exports.mesh import fuse, write_mesh
    from gs2ci.evaluate.points import Cameras, of_one_moment
    from gs2ci.evaluate.sureness import errors_at

    opened = run if isinstance(run, Run) else open_run(run)
    target = Path(path)
    _check_ending("a mesh, which is PLY,", target, "mesh.ply")
    check_free(target, opened, overwrite=overwrite)
    depth, confidence = _depth(opened), opened.depth_confidence
    motion = opened.report.motion
    seen = of_one_moment(len(depth), moves=motion is not None and motion.moves)
    cameras = Cameras(opened.path[seen], opened.intrinsics, opened.distortion)
    sure = None if confidence is None else confidence[seen]
    found = fuse(depth[seen], opened.views[seen], cameras, sure, voxels=voxels, least_share=least_share)
    errors = opened.depth_error
    stated = (
        None if errors is None else errors_at(found.vertices.astype(np.float64), depth[seen], errors[seen], cameras)
    )
    return write_mesh(target, found, stated)


_Write = Callable[[Path], object]


@dataclass(frozen=True)
class _Asked:
    """A run and its folder, what some formats can be told, and where they say what they changed."""

    run: Run
    folder: Path
    as_fitted: bool
    f_rest: bool
    spz_version: Literal[2, 3]
    say: Callable[[str], None]

    @property
    def depth(self) -> "F32 | None":
        """Get the depth; None if the run has none, or no camera path to measure it by."""
        return None if self.run.report.lacks_path else self.run.depth

    def scene_to_show(self) -> "Gaussians":
        """Return the Gaussians as a file for viewers holds them."""
        if self.as_fitted:
            return self.run.scene
        import torch

        from gs2ci.evaluate.exports.for_viewers import for_viewers

        height, width = self.run.views.shape[1:3]
        path, intrinsics = torch.from_numpy(self.run.path), torch.from_numpy(self.run.intrinsics)
        found = for_viewers(self.run.scene, path, intrinsics, (int(height), int(width)))
        self.say(found.sentence)
        return found.scene

    def write_views(self, path: Path) -> dict[str, Any]:
        """Make a folder that holds the views; return the transforms that belong to them."""
        from gs2ci.evaluate.whole_folder import write_pictures

        transforms: dict[str, Any] = json.loads((self.folder / "cameras.json").read_text(encoding="utf-8"))
        path.mkdir()
        write_pictures(path / "views", self.run.views)
        return transforms


def _ply(asked: _Asked) -> _Write:
    from gs2ci.render.harmonics import DEGREE_MAX
    from gs2ci.render.ply import read_ply, write_ply

    read_ply(asked.folder / "scene.ply")  # a damaged scene is refused, not copied
    if asked.as_fitted and not asked.f_rest:
        return lambda path: shutil.copyfile(asked.folder / "scene.ply", path)
    scene = asked.scene_to_show()
    return lambda path: write_ply(path, scene, degree=DEGREE_MAX if asked.f_rest else 0)


def _spz(asked: _Asked) -> _Write:
    from gs2ci.render.spz import write_spz

    scene, scale = _for_spz(asked)
    if scale != 1:
        asked.say(
            f"SPZ cannot hold these lengths: all of the file's are {scale:g} times those of the run. Divide by that to "
            f"have {asked.run.report.length_unit}, or export ply, sog or glb."
        )
    return lambda path: write_spz(path, scene, version=asked.spz_version, scale=scale)


def _for_spz(asked: _Asked) -> "tuple[Gaussians, float]":
    """Return a scene that SPZ holds under a scale, and the scale.

    Raises:
        InputError: There is none.
    """
    import torch

    from gs2ci.evaluate.exports.for_viewers import brought_nearer
    from gs2ci.render.spz import fitting_scale

    scene = asked.scene_to_show()
    found, count = scene, 0
    for distances in _SPZ_DISTANCES:
        try:
            scale = fitting_scale(found)
            break
        except InputError:
            found, count = brought_nearer(scene, torch.from_numpy(asked.run.path), distances)
    else:
        scale = fitting_scale(found)
    if count:
        asked.say(
            f"{count} of {len(scene)} Gaussians lie so much farther away than the rest that SPZ's grid of places does "
            "not reach them: in the file they are nearer, and smaller by as much, so that they look the same."
        )
    return found, scale


def _sog(asked: _Asked) -> _Write:
    from gs2ci.render.sog import write_sog

    scene = asked.scene_to_show()
    return lambda path: write_sog(path, scene)


def _glb(asked: _Asked) -> _Write:
    from gs2ci.render.glb import write_glb

    scene, report = asked.scene_to_show(), asked.run.report
    asked.say(
        "The file says that its colours are light (lin_rec709_display): a viewer that heeds it shows them as an eye "
        "sees the scene, brighter than the run's pictures, which show readings as they are."
        if report.of_light
        else "The file says that its colours are those of a screen (srgb_rec709_display): what readings from a file "
        "stand for is not known, and viewers so show them like the run's pictures."
    )
    metres_per_unit = _METRES.get(report.length_unit)
    return lambda path: write_glb(path, scene, metres_per_unit=metres_per_unit, of_light=report.of_light)


def _colmap(asked: _Asked) -> _Write:
    from gs2ci.evaluate.whole_folder import write_pictures

    if asked.run.distortion is not None:
        asked.say(
            "The pictures are distorted as the lens has it, and the model says so. Programs that take pinhole cameras "
            "only, 3DGS's own training among them, need `colmap image_undistorter` first."
        )

    def write(path: Path) -> None:
        model = path / "sparse" / "0"
        model.mkdir(parents=True)
        own = asked.folder / "colmap" / "sparse" / "0"
        for file in own.iterdir():  # the error of `copytree` is a list of all files
            shutil.copyfile(file, model / file.name)
        write_pictures(path / "images", asked.run.views)

    return write


def _nerfstudio(asked: _Asked) -> _Write:
    from gs2ci.evaluate.cameras import split_of
    from gs2ci.evaluate.exports.depth_files import write_nerfstudio_depth

    def write(path: Path) -> None:
        transforms = asked.write_views(path)
        if (asked.folder / "points.ply").is_file():
            shutil.copyfile(asked.folder / "points.ply", path / "points.ply")
            transforms["ply_file_path"] = "points.ply"
        if asked.depth is not None:
            for frame, name in zip(transforms["frames"], write_nerfstudio_depth(path, asked.depth), strict=True):
                frame["depth_file_path"] = name
        transforms |= split_of([frame["file_path"] for frame in transforms["frames"]])
        _write_transforms(path, transforms)

    return write


def _instant_ngp(asked: _Asked) -> _Write:
    from gs2ci.evaluate.cameras import ngp_box
    from gs2ci.evaluate.points import surface_points

    run, depth = asked.run, asked.depth
    points = np.zeros((0, 3)) if depth is None else surface_points(depth, _cameras(run), run.depth_confidence)
    box = ngp_box(points, run.path)
    if run.distortion is not None and run.distortion[4] != 0:
        asked.say(f"instant-ngp knows no k3; that of this lens, {run.distortion[4]:.3g}, is left out.")

    def write(path: Path) -> None:
        transforms = asked.write_views(path)
        del transforms["camera_model"], transforms["k3"]
        _write_transforms(path, {**box, **transforms})

    return write


def _write_transforms(folder: Path, transforms: dict[str, Any]) -> None:
    (folder / "transforms.json").write_text(json.dumps(transforms, indent=1), encoding="utf-8")


def _depth_png(asked: _Asked) -> _Write:
    from gs2ci.evaluate.exports.depth_files import write_depth_png

    return _into_a_folder(write_depth_png, asked)


def _depth_exr(asked: _Asked) -> _Write:
    from gs2ci.evaluate.exports.depth_files import write_depth_exr

    return _into_a_folder(write_depth_exr, asked)


def _into_a_folder(write_files: Callable[..., object], asked: _Asked) -> _Write:
    depth = _depth(asked.run)

    def write(path: Path) -> None:
        path.mkdir()
        write_files(path, depth, unit=asked.run.report.length_unit)

    return write


def _nexus(asked: _Asked) -> _Write:
    from gs2ci.evaluate.exports.nexus import write_nexus

    run, depth = asked.run, asked.depth
    return lambda path: write_nexus(path, run.report, run.views, depth, _cameras(run))


def _film(asked: _Asked) -> _Write:
    from gs2ci.evaluate.exports.orbit import write_film

    frames = orbit(asked.run)
    return lambda path: write_film(path, frames)


@dataclass(frozen=True)
class _Format:
    """A format of exports.

    Args:
        name: Of the output if none is given, inside the folder if one is.
        writer: Checks a run and prepares it; returns what writes the output.
        files: Of a folder, the pattern of every file's path inside; one that holds another file is no such export.
    """

    name: str
    writer: Callable[[_Asked], _Write]
    files: str | None = None


FORMATS: Final[dict[ExportFormat, _Format]] = {
    "ply": _Format("scene.ply", _ply),
    "spz": _Format("scene.spz", _spz),
    "sog": _Format("scene.sog", _sog),
    "glb": _Format("scene.glb", _glb),
    "colmap": _Format("colmap", _colmap, r"sparse/0/\w+\.(bin|txt)|images/view_\d+\.png"),
    "nerfstudio": _Format(
        "nerfstudio",
        _nerfstudio,
        r"transforms\.json|points\.ply|views/view_\d+\.png|depth/depth_\d+\.npy",
    ),
    "instant-ngp": _Format("instant-ngp", _instant_ngp, r"transforms\.json|views/view_\d+\.png"),
    "depth-png": _Format("depth-png", _depth_png, r"depth\.json|depth_\d+\.png"),
    "depth-exr": _Format("depth-exr", _depth_exr, r"depth_\d+\.exr"),
    "nexus": _Format("run.nxs", _nexus),
    "gif": _Format("orbit.gif", _film),
    "mp4": _Format("orbit.mp4", _film),
}


def orbit(run: Run) -> "F32":
    """Render a short orbit of a run's scene, [F, H, W, 3], at the middle of the exposure.

    Raises:
        InputError: The scene is empty.
    """
    import torch

    from gs2ci.evaluate.exports.orbit import orbit_poses
    from gs2ci.render.backend import load_backend

    scene = run.scene
    if not len(scene):
        raise InputError("the scene holds no Gaussian", remedy="see report.html for why")
    middle = len(run.path) // 2
    seen = run.depth[middle][run.depth[middle] > 0] if run.depth is not None else np.zeros(0)
    if not len(seen):
        ahead = scene.means.double().numpy() @ run.path[middle, 2, :3] + run.path[middle, 2, 3]
        seen = ahead[ahead > 0] if (ahead > 0).any() else np.ones(1)
    poses = torch.from_numpy(orbit_poses(run.path, float(np.median(seen)))).float()
    height, width = run.views.shape[1:3]
    with torch.no_grad():
        images, _ = load_backend().views(
            scene.map(torch.Tensor.float),
            poses,
            torch.from_numpy(run.intrinsics).float(),
            (int(height), int(width)),
            times=torch.zeros(len(poses)),
        )
    return images.numpy()


def _depth(run: Run) -> "F32":
    """Return a run's depth.

    Raises:
        InputError: It has none, or no camera path to measure it by.
    """
    run.report.check_depth()
    if run.depth is None:
        raise InputError(
            "the run holds no depth",
            allowed="a run with depth.npy",
            remedy="reconstruct again; a camera that does not move shows no depth",
        )
    return run.depth


def _cameras(run: Run) -> "Cameras":
    from gs2ci.evaluate.points import Cameras

    return Cameras(run.path, run.intrinsics, run.distortion)
