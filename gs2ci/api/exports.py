"""Parts of a run as files for other programs: `export`, `mesh`.

Here: the list of parts, and writing a file or folder completely or not at all. Not here: the formats
(`gs2ci.evaluate.exports`, `gs2ci.render`).
"""

import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np

from gs2ci.api.options import check_choice
from gs2ci.api.runs import Run, open_run
from gs2ci.core.errors import InputError, StorageError
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


def export(run: Run | str | Path, to: ExportFormat, path: str | Path | None = None, *, overwrite: bool = False) -> Path:
    """Write a part of a saved run for another program.

    Args:
        run: A run that was saved, or its folder.
        to: ply and spz contain the Gaussians; colmap is a folder with sparse model and images, nerfstudio one with
            transforms.json and images; depth-png (16 bit) and depth-exr are folders of depth maps; nexus is an HDF5
            file with views, depth and cameras under the names of the NeXus standard; gif and mp4 show a short orbit of
            the scene.
        path: The file or folder to write; by default one with the format's usual name in the current folder.
        overwrite: Replace an existing output; a folder is replaced as a whole.

    Returns:
        The path.

    Raises:
        InputError: The format is unknown, the run has no such part, or a package is missing.
        StorageError: The output exists already, or writing fails.

    Example:
        >>> gs2ci.export("run", "spz").name, gs2ci.export("run", "depth-png", "maps").is_dir()
        ('scene.spz', True)
    """
    check_choice("--to", to, get_args(ExportFormat))
    opened = run if isinstance(run, Run) else open_run(run)
    if opened.folder is None:
        raise InputError("the run has no folder yet", remedy="call save() first")
    target = Path(NAMES[to] if path is None else path)
    return _whole(target, _WRITERS[to](opened, opened.folder), overwrite=overwrite)


def mesh(run: Run | str | Path, path: str | Path = "mesh.ply", *, voxels: int = 160, overwrite: bool = False) -> Path:
    """Write a mesh of the surfaces in a run's depth maps, as PLY with a colour per vertex.

    The mesh is closed only if the views see a surface from all sides; otherwise it ends where they see no more.

    Args:
        run: A run that was saved, or its folder.
        path: The file to write.
        voxels: Number along the longest side of the visible scene: more are finer; memory grows with their cube.
        overwrite: Replace an existing file.

    Returns:
        The path.

    Raises:
        InputError: The run has no reliable depth, or `voxels` is out of bounds.
        StorageError: The output exists already, or writing fails.

    Example:
        >>> gs2ci.mesh("run", voxels=32).name
        'mesh.ply'
    """
    from gs2ci.evaluate.exports.mesh import fuse, write_mesh

    opened = run if isinstance(run, Run) else open_run(run)
    target = Path(path)
    _check_free(target, overwrite=overwrite)
    made = fuse(_depth(opened), opened.views, _cameras(opened), opened.depth_confidence, voxels=voxels)
    return write_mesh(target, made)


_Write = Callable[[Path], object]


def _ply(run: Run, folder: Path) -> _Write:
    return lambda path: shutil.copyfile(folder / "scene.ply", path)


def _spz(run: Run, folder: Path) -> _Write:
    from gs2ci.render.spz import write_spz

    scene = run.scene
    return lambda path: write_spz(path, scene)


def _colmap(run: Run, folder: Path) -> _Write:
    def write(path: Path) -> None:
        shutil.copytree(folder / "colmap", path)
        shutil.copytree(folder / "views", path / "images")

    return write


def _nerfstudio(run: Run, folder: Path) -> _Write:
    def write(path: Path) -> None:
        transforms = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))
        path.mkdir()
        shutil.copytree(folder / "views", path / "views")
        if (folder / "points.ply").is_file():
            shutil.copyfile(folder / "points.ply", path / "points.ply")
            transforms["ply_file_path"] = "points.ply"
        (path / "transforms.json").write_text(json.dumps(transforms, indent=1), encoding="utf-8")

    return write


def _depth_png(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.exports.depth_files import write_depth_png

    return _into_a_folder(write_depth_png, _depth(run))


def _depth_exr(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.exports.depth_files import write_depth_exr

    return _into_a_folder(write_depth_exr, _depth(run))


def _nexus(run: Run, folder: Path) -> _Write:
    from gs2ci.evaluate.exports.nexus import write_nexus

    return lambda path: write_nexus(path, run.report, run.views, run.depth, _cameras(run))


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
        InputError: It has none.
    """
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


def _check_free(target: Path, *, overwrite: bool) -> None:
    """Check that an output can be written.

    Raises:
        StorageError: It exists and may not be replaced, or nothing can be written there.
    """
    check_place(target)
    if (target.exists() or target.is_symlink()) and not overwrite:
        raise StorageError(f"{target} exists", remedy="choose another name with -o, or add --overwrite to replace it")


def _whole(target: Path, write: _Write, *, overwrite: bool) -> Path:
    """Write a file or a folder under a temporary name, and move it to its place.

    Raises:
        StorageError: As `_check_free`; or writing fails.
    """
    _check_free(target, overwrite=overwrite)
    try:
        with tempfile.TemporaryDirectory(dir=target.resolve().parent, prefix=f".{target.name}.") as scratch:
            made = Path(scratch) / target.name
            write(made)
            if target.is_dir() and not target.is_symlink():
                # It is deleted with the scratch folder.
                target.rename(Path(scratch) / "before")
            made.replace(target)
    except OSError as error:
        raise StorageError(
            f"{target} cannot be written: {error}", remedy="check the free space and the permissions"
        ) from error
    return target
