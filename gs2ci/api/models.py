"""Registering model files under names.

Here: `add_model`, `list_models`. Not here: any network (`gs2ci.reconstruct.learned`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.reconstruct.choices import MODEL_NAMES, ModelName


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
