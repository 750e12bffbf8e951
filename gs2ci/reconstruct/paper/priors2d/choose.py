"""Priors on images by name."""

from pathlib import Path
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.core.plugins import allowed, brought
from gs2ci.reconstruct.learned.onnx_models import find_model, known_model
from gs2ci.reconstruct.paper.priors2d.base import ImagePrior
from gs2ci.reconstruct.paper.priors2d.onnx_prior import OnnxPrior

_FILE: Final = "onnx:"
PRIOR_NAMES: Final = ("none", "difix")
PRIOR_GROUP: Final = "gs2ci.priors"


def load_prior(name: str, seed: int) -> ImagePrior | None:
    """Load a prior.

    Args:
        name: "none"; "difix", the model added under that name; "onnx:FILE"; "difix-or-none", the former if it has been
            added; or the name of a plug-in, called with the seed.
        seed: For a model that draws at random.

    Raises:
        InputError: No such name, or the model file cannot be used.
        StorageError: The list of added models cannot be read.
    """
    if name == "difix-or-none":
        name = "none" if known_model("difix") is None else "difix"
    if name == "none":
        return None
    if name == "difix":
        return OnnxPrior(find_model("difix"), seed)
    if name.startswith(_FILE):
        return OnnxPrior(Path(name.removeprefix(_FILE)), seed)
    prior = brought(PRIOR_GROUP, name, seed)
    if prior is None:
        raise InputError(f"prior {name!r}", allowed=f"{allowed(PRIOR_GROUP, PRIOR_NAMES)}, onnx:FILE or difix-or-none")
    return prior
