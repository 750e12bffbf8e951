"""Weight files of PyTorch: reading them without running code from them, and folding their batch normalisations.

Here: the state dictionary with a clear error for every refusal, and batch normalisations folded into convolutions. Not
here: which layers a network has (`ffdnet`, `fastdvdnet`).
"""

import pickle
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import torch
from torch import Tensor

from gs2ci.core.errors import InputError

# First bytes of PyTorch files: present archives, and older pickles.
_OF_PYTORCH: Final = (b"PK\x03\x04", b"\x80")
_BATCH_NORM_EPSILON: Final = 1e-5
_BATCH_NORM: Final = ("weight", "bias", "running_mean", "running_var")


@dataclass(frozen=True)
class Convolution:
    """One layer: weight, [O, I, 3, 3], and bias, [O], float32; and whether a batch normalisation was folded into it."""

    weight: Tensor
    bias: Tensor
    normalised: bool = False


def read_state(path: Path, network: str) -> dict[str, Tensor]:
    """Read a state dictionary; only tensors are unpickled, so a weight file cannot run code.

    Args:
        path: The file.
        network: What it should hold, for the message.

    Raises:
        InputError: No such file, or not a state dictionary.
    """
    if not path.is_file():
        raise InputError(f"no weight file {path}", remedy=f"give the .pth file of a trained {network}")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError) as error:
        raise InputError(
            f"{path} is not a PyTorch weight file: {_what_is_wrong(path, error)}",
            allowed="what torch.save wrote of a state dictionary: names and tensors (.pth, .pt)",
            remedy="check that it is the weight file, and complete",
        ) from error
    for key in ("state_dict", "params"):  # training scripts often store the weights together with other data
        if isinstance(state, dict) and isinstance(state.get(key), dict):
            state = state[key]
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise InputError(f"{path} holds no state dictionary", allowed="names and tensors")
    return {name: value.float() for name, value in state.items()}


def folded(modules: Iterable[Mapping[str, Tensor]]) -> tuple[Convolution, ...]:
    """Fold each batch normalisation into the convolution before it.

    Args:
        modules: Their tensors by the names that PyTorch gives them, in the order of the network.

    Returns:
        The convolutions; none if the modules are not of 3 x 3, each with at most one normalisation after it.
    """
    layers: list[Convolution] = []
    for module in modules:
        weight = module.get("weight")
        if weight is not None and weight.ndim == 4 and weight.shape[2:] == (3, 3):
            layers.append(Convolution(weight, module.get("bias", torch.zeros(len(weight)))))
            continue
        parts = [module.get(part) for part in _BATCH_NORM]
        if not layers or any(part is None or part.shape != layers[-1].bias.shape for part in parts):
            return ()
        layers[-1] = _fold(layers[-1], *(part.double() for part in parts if part is not None))
    return tuple(layers)


def _fold(layer: Convolution, gain: Tensor, shift: Tensor, mean: Tensor, variance: Tensor) -> Convolution:
    scale = gain / torch.sqrt(variance + _BATCH_NORM_EPSILON)
    weight = layer.weight.double() * scale[:, None, None, None]
    return Convolution(weight.float(), ((layer.bias.double() - mean) * scale + shift).float(), normalised=True)


def _what_is_wrong(path: Path, error: Exception) -> str:
    """Describe a file that PyTorch refuses; its own message only if it is a PyTorch file."""
    with path.open("rb") as stream:
        head = stream.read(24)
    if not head:
        return "it is empty"
    if head.startswith(_OF_PYTORCH):
        reason = (str(error) or type(error).__name__).split("\n", maxsplit=1)[0][:200]
        return f"it is damaged, or holds more than tensors ({reason})"
    return f"it begins with {head.decode('ascii')!r}" if head.isascii() else f"it begins with bytes {head[:8].hex(' ')}"
