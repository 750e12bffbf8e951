"""Export of VGGT, from the authors' code and weights if a user has both, to the ONNX file that `vggt` runs.

Here: the wrapper, the tracing, and the check of the written file. Not here: the network; it is imported from the
package `vggt` of its authors, which gs2ci neither ships nor needs otherwise.
"""

import importlib
import pickle
import shutil
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.errors import InputError, NumericsError, StorageError
from gs2ci.reconstruct.learned.onnx_models import onnx_package, trace
from gs2ci.reconstruct.learned.vggt import LONGER_SIDE, Vggt

# A protobuf holds at most 2 GB; larger weights are written to a second file.
_ONE_FILE_BYTES: Final = 1_500_000_000
# Tolerance: twenty-four layers of attention in float32, summed in a different order.
_AGREEMENT: Final = 0.02


def load_vggt(weights: Path) -> torch.nn.Module:
    """Build the network of the authors' package and fill in weights.

    Args:
        weights: A PyTorch state dictionary; only tensors are unpickled.

    Raises:
        InputError: The package is not installed, there is no such file, or it does not hold these weights.
    """
    try:
        network: torch.nn.Module = importlib.import_module("vggt.models.vggt").VGGT()
    except ImportError as error:
        raise InputError(
            "exporting VGGT needs the package vggt of its authors",
            remedy="install github.com/facebookresearch/vggt in this environment",
        ) from error
    if not weights.is_file():
        raise InputError(f"no weight file {weights}", remedy="name the checkpoint of VGGT-1B")
    try:
        network.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
    except (RuntimeError, TypeError, AttributeError, EOFError, OSError, pickle.UnpicklingError) as error:
        raise InputError(
            f"{weights} does not hold VGGT's weights: {str(error).splitlines()[0]}",
            allowed="the state dictionary of facebook/VGGT-1B",
        ) from error
    return network.eval()


class _PosesAndDepth(torch.nn.Module):
    """Maps images, [S, 3, H, W], to pose encodings, [S, 9], and depth, [S, H, W, 1]; the other heads are left out."""

    def __init__(self, network: Any) -> None:
        super().__init__()
        self._network = network

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        tokens, patches_from = self._network.aggregator(images[None])
        poses = self._network.camera_head(tokens)[-1]
        depth, _ = self._network.depth_head(tokens, images[None], patches_from)
        return poses[0], depth[0]


def export_vggt(network: torch.nn.Module, path: Path, views: int = 8, side: int = LONGER_SIDE) -> Path:
    """Write the network as an ONNX file with a dynamic view axis if possible, otherwise for exactly `views` views.

    Args:
        network: From `load_vggt`.
        path: The file; weights beyond 2 GB go into a second one, `path` with ".data" appended.
        views: Number of views with which it is traced.
        side: Of its square images, px; a multiple of 14.

    Raises:
        InputError: The package `onnx` is not installed, or a number is out of range.
        NumericsError: The written file's output differs from the network's.
        StorageError: The file cannot be written.
    """
    if views < 2 or side < 14 or side % 14:
        raise InputError(f"{views} views of {side} px", allowed="at least 2 views, and a multiple of 14")
    wrapped = _PosesAndDepth(network).eval()
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(views + 1, 3, side, side, generator=generator)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            written = _write(wrapped, images[:views], Path(folder), path.name, dynamic=True)
            if not _agrees(written, wrapped, images):  # with one view more than in tracing
                written = _write(wrapped, images[:views], Path(folder), path.name, dynamic=False)
                if not _agrees(written, wrapped, images[:views]):
                    raise NumericsError(
                        "the exported file's output differs from the network's", remedy="try another version of torch"
                    )
            for part in sorted(written.parent.iterdir(), reverse=True):
                shutil.move(part, path.parent / part.name)
    except OSError as error:
        raise StorageError(
            f"{path} cannot be written: {error}", remedy="check the folder, or choose another"
        ) from error
    return path


def _write(wrapped: torch.nn.Module, images: Tensor, folder: Path, name: str, *, dynamic: bool) -> Path:
    """Trace and write into a folder of its own below `folder`; returns the file."""
    onnx = onnx_package()
    traced, target = folder / f"traced-{dynamic}", folder / f"whole-{dynamic}"
    for made in (traced, target):
        made.mkdir()
    outputs = ["pose_enc", "depth"]
    axes = {key: {0: "views"} for key in ("images", *outputs)} if dynamic else None
    trace(wrapped, {"images": images}, outputs, axes, str(traced / name))
    weights = sum(parameter.nbytes for parameter in wrapped.parameters())
    onnx.save(
        onnx.load(str(traced / name)),
        str(target / name),
        save_as_external_data=weights > _ONE_FILE_BYTES,
        location=f"{name}.data",
    )
    return target / name


def _agrees(written: Path, wrapped: torch.nn.Module, images: Tensor) -> bool:
    """Tell whether the file, run as `vggt` runs it, gives the network's cameras and depth."""
    views = images.permute(0, 2, 3, 1).numpy()
    with torch.no_grad():
        poses, depth = (part.numpy() for part in wrapped(images))
    try:
        found = Vggt(written).predict(views, range(len(views)))
    except (InputError, NumericsError):
        return False
    scale = float(np.abs(depth).max()) + float(np.finfo(np.float32).tiny)
    shift = float(np.abs(poses[:, :3]).max()) + float(np.finfo(np.float32).tiny)
    return bool(
        np.abs(found.depth - depth[..., 0]).max() < _AGREEMENT * scale
        and np.abs(found.world_to_camera[:, :3, 3] - poses[:, :3]).max() < _AGREEMENT * shift
    )
