"""Parts of a run as files for other programs: `export`, `mesh`.

Here: the list of parts, and what of a run each holds. Not here: the formats (`gs2ci.evaluate.exports`,
`gs2ci.render`), what may be replaced by an export (`gs2ci.api.places`).
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, get_args

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
# Name of the output if none is given, inside the folder if one is.
NAMES: Final[dict[ExportFormat, str]] = {
    "ply": "scene.ply",
    "spz": "scene.spz",
    "sog": "scene.sog",
    "glb": "scene.glb",
    "colmap": "colmap",
    "nerfstudio": "nerfstudio",
    "instant-ngp": "instant-ngp",
    "depth-png": "depth-png",
    "depth-exr": "depth-exr",
    "nexus": "run.nxs",
    "gif": "orbit.gif",
    "mp4": "orbit.mp4",
}
# Of the exports that are folders, every file by its path inside; a folder that holds another one is no such export.
_FILES: Final[dict[str, str]] = {
    "colmap": r"sparse/0/\w+\.(bin|txt)|images/view_\d+\.png",
    "nerfstudio": r"transforms\.json|points\.ply|views/view_\d+\.png|depth/depth_\d+\.npy",
    "instant-ngp": r"transforms\.json|views/view_\d+\.png",
    "depth-png": r"depth\.json|depth_\d+\.png",
    "depth-exr": r"depth_\d+\.exr",
}


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
    target = Path(NAMES[to] if path is None else path)
    endings = {Path(name).suffix for name in NAMES.values()} - {"", Path(NAMES[to]).suffix}
    if target.suffix in endings:
        raise InputError(
            f"--to {to} into {target}", allowed=f"a name like {NAMES[to]}", remedy="change --to, or the name after -o"
        )
    check_free(target, opened, _FILES.get(to), overwrite=overwrite)
    told = Silent() if progress is None else progress
    options = _Options(as_fitted=as_fitted, f_rest=f_rest, spz_version=spz_version, say=told.say)
    return write_to(target, _WRITERS[to](opened, opened.folder, options))


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
        InputError: The run has no reliable depth, or no camera path, or `voxels` is out of bounds.
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
class _Options:
    """What some formats can be told, and where they say what they changed."""

    as_fitted: bool
    f_rest: bool
    spz_version: Literal[2, 3]
    say: Callable[[str], None]


def _scene_to_show(run: Run, options: _Options) -> "Gaussians":
    """Return the Gaussians as a file for viewers holds them."""
    if options.as_fitted:
        return run.scene
    import torch

    from gs2ci.evaluate.exports.for_viewers import for_viewers

    height, width = run.views.shape[1:3]
    path, intrinsics = torch.from_numpy(run.path), torch.from_numpy(run.intrinsics)
    found = for_viewers(run.scene, path, intrinsics, (int(height), int(width)))
    options.say(found.sentence)
    return found.scene


def _ply(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.render.harmonics import DEGREE_MAX
    from gs2ci.render.ply import read_ply, write_ply

    read_ply(folder / "scene.ply")  # a damaged scene is refused, not copied
    if options.as_fitted and not options.f_rest:
        return lambda path: shutil.copyfile(folder / "scene.ply", path)
    scene = _scene_to_show(run, options)
    return lambda path: write_ply(path, scene, degree=DEGREE_MAX if options.f_rest else 0)


def _spz(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.render.spz import write_spz

    scene, scale = _for_spz(_scene_to_show(run, options), run, options)
    if scale != 1:
        options.say(
            f"SPZ cannot hold these lengths: all of the file's are {scale:g} times those of the run. Divide by that to "
            f"have {run.report.length_unit}, or export ply, sog or glb."
        )
    return lambda path: write_spz(path, scene, version=options.spz_version, scale=scale)


def _for_spz(scene: "Gaussians", run: Run, options: _Options) -> "tuple[Gaussians, float]":
    """Return a scene that SPZ holds under a scale, and the scale.

    Raises:
        InputError: There is none.
    """
    import torch

    from gs2ci.evaluate.exports.for_viewers import brought_nearer
    from gs2ci.render.spz import fitting_scale

    found, count = scene, 0
    for distances in _SPZ_DISTANCES:
        try:
            scale = fitting_scale(found)
            break
        except InputError:
            found, count = brought_nearer(scene, torch.from_numpy(run.path), distances)
    else:
        scale = fitting_scale(found)
    if count:
        options.say(
            f"{count} of {len(scene)} Gaussians lie so much farther away than the rest that SPZ's grid of places does "
            "not reach them: in the file they are nearer, and smaller by as much, so that they look the same."
        )
    return found, scale


def _sog(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.render.sog import write_sog

    scene = _scene_to_show(run, options)
    return lambda path: write_sog(path, scene)


def _glb(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.render.glb import write_glb

    scene = _scene_to_show(run, options)
    return lambda path: write_glb(path, scene, metres_per_unit=_METRES.get(run.report.length_unit))


def _colmap(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.evaluate.whole_folder import write_pictures

    def write(path: Path) -> None:
        model = path / "sparse" / "0"
        model.mkdir(parents=True)
        for file in (folder / "colmap" / "sparse" / "0").iterdir():  # the error of `copytree` is a list of all files
            shutil.copyfile(file, model / file.name)
        write_pictures(path / "images", run.views)

    return write


def _nerfstudio(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.evaluate.cameras import split_of
    from gs2ci.evaluate.exports.depth_files import write_nerfstudio_depth
    from gs2ci.evaluate.whole_folder import write_pictures

    depth = None if run.report.lacks_path else run.depth

    def write(path: Path) -> None:
        transforms = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))
        path.mkdir()
        write_pictures(path / "views", run.views)
        if (folder / "points.ply").is_file():
            shutil.copyfile(folder / "points.ply", path / "points.ply")
            transforms["ply_file_path"] = "points.ply"
        if depth is not None:
            for frame, name in zip(transforms["frames"], write_nerfstudio_depth(path, depth), strict=True):
                frame["depth_file_path"] = name
        transforms |= split_of([frame["file_path"] for frame in transforms["frames"]])
        (path / "transforms.json").write_text(json.dumps(transforms, indent=1), encoding="utf-8")

    return write


def _instant_ngp(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.evaluate.cameras import ngp_box
    from gs2ci.evaluate.points import surface_points
    from gs2ci.evaluate.whole_folder import write_pictures

    depth = None if run.report.lacks_path else run.depth
    points = np.zeros((0, 3)) if depth is None else surface_points(depth, _cameras(run), run.depth_confidence)
    box = ngp_box(points, run.path)
    if run.distortion is not None and run.distortion[4] != 0:
        options.say(f"instant-ngp knows no k3; that of this lens, {run.distortion[4]:.3g}, is left out.")

    def write(path: Path) -> None:
        transforms = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))
        path.mkdir()
        write_pictures(path / "views", run.views)
        del transforms["camera_model"], transforms["k3"]
        (path / "transforms.json").write_text(json.dumps({**box, **transforms}, indent=1), encoding="utf-8")

    return write


def _depth_png(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.evaluate.exports.depth_files import write_depth_png

    return _into_a_folder(partial(write_depth_png, unit=run.report.length_unit), _depth(run))


def _depth_exr(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.evaluate.exports.depth_files import write_depth_exr

    return _into_a_folder(partial(write_depth_exr, unit=run.report.length_unit), _depth(run))


def _nexus(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.evaluate.exports.nexus import write_nexus

    depth = None if run.report.lacks_path else run.depth
    return lambda path: write_nexus(path, run.report, run.views, depth, _cameras(run))


def _into_a_folder(write_files: "Callable[[Path, F32], object]", depth: "F32") -> _Write:
    def write(path: Path) -> None:
        path.mkdir()
        write_files(path, depth)

    return write


def _film(run: Run, folder: Path, options: _Options) -> _Write:
    from gs2ci.evaluate.exports.orbit import write_film

    frames = orbit(run)
    return lambda path: write_film(path, frames)


_WRITERS: Final[dict[ExportFormat, Callable[[Run, Path, _Options], _Write]]] = {
    "ply": _ply,
    "spz": _spz,
    "sog": _sog,
    "glb": _glb,
    "colmap": _colmap,
    "nerfstudio": _nerfstudio,
    "instant-ngp": _instant_ngp,
    "depth-png": _depth_png,
    "depth-exr": _depth_exr,
    "nexus": _nexus,
    "gif": _film,
    "mp4": _film,
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
