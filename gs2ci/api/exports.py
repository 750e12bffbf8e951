"""Parts of a run as files for other programs: `export`, `mesh`.

Here: the list of parts, and writing a file or folder completely or not at all. Not here: the formats
(`gs2ci.evaluate.exports`, `gs2ci.render`).
"""

import json
import re
import shutil
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np

from gs2ci.api.options import check_choice
from gs2ci.api.runs import Run, open_run
from gs2ci.core.errors import InputError, StorageError, reason_of
from gs2ci.core.whole_file import check_place

if TYPE_CHECKING:
    from gs2ci.core.arrays import F32
    from gs2ci.evaluate.points import Cameras

ExportFormat = Literal["ply", "spz", "colmap", "nerfstudio", "depth-png", "depth-exr", "nexus", "gif", "mp4"]
# Name of the output if none is given, inside the folder if one is.
NAMES: Final[dict[ExportFormat, str]] = {
    "ply": "scene.ply",
    "spz": "scene.spz",
    "colmap": "colmap",
    "nerfstudio": "nerfstudio",
    "depth-png": "depth-png",
    "depth-exr": "depth-exr",
    "nexus": "run.nxs",
    "gif": "orbit.gif",
    "mp4": "orbit.mp4",
}
# Of the exports that are folders, every file by its path inside; a folder that holds another one is no such export.
_FILES: Final[dict[str, str]] = {
    "colmap": r"sparse/0/\w+\.(bin|txt)|images/view_\d+\.png",
    "nerfstudio": r"transforms\.json|points\.ply|views/view_\d+\.png",
    "depth-png": r"depth\.json|depth_\d+\.png",
    "depth-exr": r"depth_\d+\.exr",
}


def export(run: Run | str | Path, to: ExportFormat, path: str | Path | None = None, *, overwrite: bool = False) -> Path:
    """Write a part of a saved run for another program.

    Args:
        run: A run that was saved, or its folder.
        to: ply and spz contain the Gaussians; colmap is a folder with sparse model and images, nerfstudio one with
            transforms.json and images; depth-png (16 bit) and depth-exr are folders of depth maps; nexus is an HDF5
            file with views, depth and cameras under the names of the NeXus standard; gif and mp4 show a short orbit of
            the scene.
        path: The file or folder to write; by default one with the format's usual name in the current folder.
        overwrite: Replace an existing file, or a folder that is an earlier export to the same format, as a whole.
            Nothing inside the run folder is replaced.

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
    _check_free(target, opened, _FILES.get(to), overwrite=overwrite)
    return _whole(target, _WRITERS[to](opened, opened.folder))


def mesh(run: Run | str | Path, path: str | Path = "mesh.ply", *, voxels: int = 160, overwrite: bool = False) -> Path:
    """Write a mesh of the surfaces in a run's depth maps, as PLY with a colour per vertex.

    The mesh is closed only if the views see a surface from all sides; otherwise it ends where they see no more. If
    things move, it shows what the middle view sees.

    Args:
        run: A run that was saved, or its folder.
        path: The file to write.
        voxels: Number along the longest side of the visible scene: more are finer; memory grows with their cube.
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

    opened = run if isinstance(run, Run) else open_run(run)
    target = Path(path)
    _check_free(target, opened, overwrite=overwrite)
    depth, confidence = _depth(opened), opened.depth_confidence
    motion = opened.report.motion
    seen = of_one_moment(len(depth), moves=motion is not None and motion.moves)
    cameras = Cameras(opened.path[seen], opened.intrinsics, opened.distortion)
    sure = None if confidence is None else confidence[seen]
    return write_mesh(target, fuse(depth[seen], opened.views[seen], cameras, sure, voxels=voxels))


_Write = Callable[[Path], object]


def _ply(run: Run, folder: Path) -> _Write:
    from gs2ci.render.ply import read_ply

    read_ply(folder / "scene.ply")  # a damaged scene is refused, not copied
    return lambda path: shutil.copyfile(folder / "scene.ply", path)


def _spz(run: Run, folder: Path) -> _Write:
    from gs2ci.render.spz import write_spz

    scene = run.scene
    return lambda path: write_spz(path, scene)


def _colmap(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.whole_folder import write_pictures

    def write(path: Path) -> None:
        model = path / "sparse" / "0"
        model.mkdir(parents=True)
        for file in (folder / "colmap" / "sparse" / "0").iterdir():  # the error of `copytree` is a list of all files
            shutil.copyfile(file, model / file.name)
        write_pictures(path / "images", run.views)

    return write


def _nerfstudio(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.whole_folder import write_pictures

    def write(path: Path) -> None:
        transforms = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))
        path.mkdir()
        write_pictures(path / "views", run.views)
        if (folder / "points.ply").is_file():
            shutil.copyfile(folder / "points.ply", path / "points.ply")
            transforms["ply_file_path"] = "points.ply"
        (path / "transforms.json").write_text(json.dumps(transforms, indent=1), encoding="utf-8")

    return write


def _depth_png(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.exports.depth_files import write_depth_png

    return _into_a_folder(partial(write_depth_png, unit=run.report.length_unit), _depth(run))


def _depth_exr(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.exports.depth_files import write_depth_exr

    return _into_a_folder(write_depth_exr, _depth(run))


def _nexus(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.exports.nexus import write_nexus

    depth = None if run.report.lacks_path else run.depth
    return lambda path: write_nexus(path, run.report, run.views, depth, _cameras(run))


def _into_a_folder(write_files: "Callable[[Path, F32], object]", depth: "F32") -> _Write:
    def write(path: Path) -> None:
        path.mkdir()
        write_files(path, depth)

    return write


def _film(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.exports.orbit import write_film

    frames = orbit(run)
    return lambda path: write_film(path, frames)


_WRITERS: Final[dict[ExportFormat, Callable[[Run, Path], _Write]]] = {
    "ply": _ply,
    "spz": _spz,
    "colmap": _colmap,
    "nerfstudio": _nerfstudio,
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


def _check_free(target: Path, run: Run, files: str | None = None, *, overwrite: bool) -> None:
    """Check that an output can be written, and that nothing is lost by it but an earlier output.

    Args:
        target: The file or folder.
        run: The run that it is made of.
        files: Pattern of the paths inside it, if it is a folder; None for a file.
        overwrite: Whether an earlier output may be replaced.

    Raises:
        StorageError: It exists and may not be replaced, or nothing can be written there.
    """
    check_place(target)
    if not target.resolve().parent.is_dir():
        raise StorageError(
            f"{target} cannot be written: there is no folder {target.parent}", remedy="create it, or choose another"
        )
    if not (target.exists() or target.is_symlink()):
        return
    if not overwrite:
        raise StorageError(f"{target} exists", remedy="choose another name with -o, or add --overwrite to replace it")
    place = target.resolve()
    if run.folder is not None and (home := run.folder.resolve()) in (place, *place.parents):
        raise StorageError(
            f"{target} belongs to the run folder {home}, where an export replaces nothing",
            remedy="choose another place with -o, or move it away first",
        )
    if (target.is_dir() and not target.is_symlink()) != (files is not None):
        kind = "file" if files is None else "folder"
        raise StorageError(
            f"{target} is not a {kind}, and is not replaced by one", remedy="choose another name with -o"
        )
    if files is not None and (other := _other_file(target, files)) is not None:
        raise StorageError(
            f"{target} holds something other than an export of this kind, which is not replaced: {other}",
            remedy="choose another place with -o",
        )


def _other_file(folder: Path, files: str) -> Path | None:
    """Return the first file inside a folder whose path there does not match a pattern; None if there is none."""
    inside = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    return next((path for path in inside if not re.fullmatch(files, path.relative_to(folder).as_posix())), None)


def _whole(target: Path, write: _Write) -> Path:
    """Write a file or a folder under a temporary name, and move it to its place, which `_check_free` has checked.

    Raises:
        StorageError: Writing fails.
    """
    from gs2ci.evaluate.whole_folder import swap_in

    made = target
    try:
        with tempfile.TemporaryDirectory(dir=target.resolve().parent, prefix=f".{target.name}.") as scratch:
            made = Path(scratch) / target.name
            write(made)
            if target.is_dir() and not target.is_symlink():
                swap_in(made, target, Path(scratch) / "before")
            else:
                made.replace(target)
    except (OSError, StorageError) as error:
        # The user knows the name of the output, and not the temporary one.
        told = error.problem if isinstance(error, StorageError) else f"cannot be written: {reason_of(error)}"
        told = told.replace(str(made), str(target))
        raise StorageError(
            told if told.startswith(str(target)) else f"{target}: {told}",
            remedy="check the free space and the permissions",
        ) from error
    return target
