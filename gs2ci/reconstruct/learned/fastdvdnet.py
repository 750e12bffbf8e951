"""FastDVDnet (Tassano, Delon, Veit 2020): reading a user's trained weights and writing them as an ONNX video denoiser.

Here: the network as its paper describes it, for any number of channels and of convolutions in a stage. Not here: how
its graph is traced (`onnx_models`), and running the model (`onnx_video_denoiser`).

Five frames are denoised in two steps. A small U-Net takes three frames, each with a map of sigma, and returns the
middle one; it is applied to frames 1 to 3, 2 to 4 and 3 to 5, and a second one of the same shape to the three results.
A U-Net has a stage at full size, two that halve it, two that double it, and one that returns the noise of the middle
frame. Narrower variants with the same stages (LiteDVDNet) can be read as well.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.learned.onnx_models import write_traced
from gs2ci.reconstruct.learned.weight_file import Convolution, folded, read_state

_AT_ONCE: Final = 3
FRAMES: Final = 2 * _AT_ONCE - 1
# The authors' names of the stages of a U-Net, in their order.
_STAGES: Final = ("inc", "downc0", "downc1", "upc2", "upc1", "outc")
_NAME: Final = re.compile(r"(temp[12])\.(\w+?)\.(.*\.)(weight|bias|running_mean|running_var)$")
_ALLOWED: Final = "the state dictionary of FastDVDnet for colour: temp1 and temp2, each with " + ", ".join(_STAGES)


@dataclass(frozen=True)
class UNet:
    """One of the two steps: the layers of its stages, by the authors' names; a ReLU follows a batch normalisation."""

    stages: dict[str, tuple[Convolution, ...]]

    def __call__(self, frames: list[Tensor], level: Tensor) -> Tensor:
        """Denoise the middle one of three frames, each [N, 3, H, W]; `level` is sigma's map, [N, 1, H, W]."""
        x0 = self._stage("inc", torch.cat([part for frame in frames for part in (frame, level)], dim=1))
        x1 = self._stage("downc0", x0)
        x2 = functional.pixel_shuffle(self._stage("upc2", self._stage("downc1", x1)), 2)
        x1 = functional.pixel_shuffle(self._stage("upc1", x1 + x2), 2)
        return frames[len(frames) // 2] - self._stage("outc", x0 + x1)

    def _stage(self, name: str, x: Tensor) -> Tensor:
        for i, layer in enumerate(self.stages[name]):
            stride = 2 if name in ("downc0", "downc1") and i == 0 else 1
            how = {"stride": stride, "padding": 1, "groups": _groups(name, i)}
            x = functional.conv2d(x, layer.weight, layer.bias, **how)
            x = functional.relu(x) if layer.normalised else x
        return x


@dataclass(frozen=True)
class FastDvdNet:
    """The network of one weight file: its two steps."""

    first: UNet
    second: UNet

    def __call__(self, frames: Tensor, sigma: Tensor) -> Tensor:
        """Denoise the middle one of frames [N, 5, 3, H, W] of noise sigma, [N]: the readable definition of the graph.

        H and W must be multiples of 4.
        """
        level = sigma.reshape(-1, 1, 1, 1).expand(frames.shape[0], 1, *frames.shape[3:])
        parts = list(frames.unbind(1))
        middle = [self.first(parts[i : i + _AT_ONCE], level) for i in range(FRAMES - _AT_ONCE + 1)]
        return self.second(middle, level)


def read_fastdvdnet(path: Path) -> FastDvdNet:
    """Read a weight file.

    Raises:
        InputError: No such file, not a state dictionary, or not the layers of FastDVDnet.
    """
    layers: dict[tuple[str, str], dict[str, dict[str, Tensor]]] = {}
    for name, tensor in read_state(Path(path), "FastDVDnet").items():
        if match := _NAME.search(name):
            step, stage, place, part = match.groups()
            layers.setdefault((step, stage), {}).setdefault(place, {})[part] = tensor
    nets = []
    for step in ("temp1", "temp2"):
        stages = {stage: folded(layers.get((step, stage), {}).values()) for stage in _STAGES}
        if not _fits(stages):
            raise InputError(f"{path} does not hold the layers of FastDVDnet", allowed=_ALLOWED)
        nets.append(UNet(stages))
    return FastDvdNet(*nets)


def export_fastdvdnet(network: FastDvdNet, path: Path) -> Path:
    """Write the network as an ONNX model: `frames` [n, 5, 3, h, w] and `sigma` [n] to `denoised` [n, 3, h, w].

    Args:
        network: What `read_fastdvdnet` returned.
        path: The file to write; it appears whole or not at all.

    Raises:
        InputError: The package `onnx` is not installed.
        StorageError: The file cannot be written.
    """
    given = {"frames": torch.zeros(1, FRAMES, 3, 8, 8), "sigma": torch.zeros(1)}
    axes = {"frames": {0: "n", 3: "h", 4: "w"}, "sigma": {0: "n"}, "denoised": {0: "n", 2: "h", 3: "w"}}
    return write_traced(network, given, axes, path)


def _fits(stages: dict[str, tuple[Convolution, ...]]) -> bool:
    """Tell whether each layer's input fits the output of the one before, through all halvings and doublings."""
    channels = _AT_ONCE * 4
    given: dict[str, int] = {}
    for stage, layers in stages.items():
        if not layers:
            return False
        for i, layer in enumerate(layers):
            if layer.weight.shape[1] * _groups(stage, i) != channels:
                return False
            channels = len(layer.weight)
        if stage in ("upc2", "upc1"):
            channels, rest = divmod(channels, 4)
            if rest or channels != given["downc0" if stage == "upc2" else "inc"]:
                return False
        given[stage] = channels
    return channels == 3


def _groups(stage: str, layer: int) -> int:
    """Return the groups of a convolution: in the very first layer each frame has its own filters."""
    return _AT_ONCE if stage == "inc" and layer == 0 else 1
