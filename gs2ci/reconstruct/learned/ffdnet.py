"""FFDNet (Zhang, Zuo, Zhang 2018): reading a user's trained weights and writing them as an ONNX denoiser.

Here: the network as its paper describes it, and the layouts of weight files. Not here: how its graph is traced
(`onnx_models`), and running the model (`onnx_denoiser`).

The network rearranges an image into four half-sized ones, adds a map of sigma, runs 3 × 3 convolutions with ReLU in
between at that size, and rearranges back. Batch normalisations are folded into the convolutions before them. Files do
not state whether the map comes before the image or after it, nor whether the last layer returns the image or its noise:
all four combinations are tried, and the one that denoises is used.
"""

import re
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.learned.onnx_models import write_traced
from gs2ci.reconstruct.learned.weight_file import Convolution, folded, read_state

_PROBE_SIGMA: Final = 25 / 255
# With the right order and sign less than a fifth of the noise of a smooth image remains, with each wrong combination
# more than twice the noise.
_PROBE_SHARE_LEFT: Final = 0.75


@dataclass(frozen=True)
class FfdNet:
    """The network of one weight file.

    Args:
        layers: Its convolutions; a ReLU stands between two.
        map_first: Whether the map of sigma comes before the four sub-images, or after them.
        predicts_noise: Whether the last layer gives the noise, or the denoised image.
    """

    layers: tuple[Convolution, ...]
    map_first: bool = False
    predicts_noise: bool = False

    @property
    def channels(self) -> int:
        """Get how many channels an image has: 1 or 3."""
        return int(self.layers[-1].weight.shape[0]) // 4

    def __call__(self, images: Tensor, sigma: Tensor) -> Tensor:
        """Denoise images, [N, C, H, W] with even H and W, of noise sigma, [N]: the readable definition of the graph."""
        # The four sub-images as torch's pixel_unshuffle has them, which its exporter knows for fixed sides only.
        picked = torch.eye(4 * self.channels).reshape(-1, self.channels, 2, 2)
        small = functional.conv2d(images, picked, stride=2)
        level = sigma.reshape(-1, 1, 1, 1).expand(small.shape[0], 1, *small.shape[2:])
        x = torch.cat([level, small] if self.map_first else [small, level], dim=1)
        for i, layer in enumerate(self.layers):
            x = functional.conv2d(functional.relu(x) if i else x, layer.weight, layer.bias, padding=1)
        restored = functional.pixel_shuffle(x, 2)
        return images - restored if self.predicts_noise else restored


def read_ffdnet(path: Path) -> FfdNet:
    """Read a weight file.

    Args:
        path: A PyTorch state dictionary: convolutions, with or without bias, each with or without a batch
            normalisation after it, numbered in their keys.

    Raises:
        InputError: No such file, not a state dictionary, not the layers of an FFDNet, or weights that do not denoise.

    Only tensors are unpickled: a weight file cannot run code.
    """
    layers = _layers(read_state(Path(path), "FFDNet"), Path(path))
    network = _resolve(FfdNet(layers))
    if network is None:
        raise InputError(
            f"the weights in {path} do not denoise, in whatever order their inputs are taken",
            allowed="trained FFDNet weights, for images with full scale 1",
        )
    return network


def export_ffdnet(network: FfdNet, path: Path) -> Path:
    """Write the network as an ONNX model: `noisy` [n, C, h, w] and `sigma` [n] to `denoised` [n, C, h, w].

    Height and width must be even; `OnnxDenoiser` pads others.

    Args:
        network: What `read_ffdnet` returned.
        path: The file to write; it appears whole or not at all.

    Raises:
        InputError: The package `onnx` is not installed.
        StorageError: The file cannot be written.
    """
    sides = {0: "n", 2: "h", 3: "w"}
    given = {"noisy": torch.zeros(1, network.channels, 8, 8), "sigma": torch.zeros(1)}
    return write_traced(network, given, {"noisy": sides, "sigma": {0: "n"}, "denoised": sides}, path)


def _layers(state: dict[str, Tensor], path: Path) -> tuple[Convolution, ...]:
    """Sort the tensors by the numbers in their names; fold each batch normalisation into the layer before it."""
    modules: dict[int, dict[str, Tensor]] = {}
    for name, tensor in state.items():
        if match := re.search(r"(\d+)\.(weight|bias|running_mean|running_var)$", name):
            modules.setdefault(int(match[1]), {})[match[2]] = tensor
    layers = folded(module for _, module in sorted(modules.items()))
    if not _chained(layers):
        raise InputError(
            f"{path} does not hold the layers of an FFDNet",
            allowed="3 x 3 convolutions from 5 (grey) or 13 (colour) channels back to 4 or 12",
        )
    return layers


def _chained(layers: tuple[Convolution, ...]) -> bool:
    """Tell whether each layer's input fits the output before it, and the whole has FFDNet's input and output."""
    if len(layers) < 2:
        return False
    shapes = [layer.weight.shape for layer in layers]
    through = all(before[0] == after[1] for before, after in pairwise(shapes))
    return through and (shapes[0][1], shapes[-1][0]) in ((5, 4), (13, 12))


def _resolve(network: FfdNet) -> FfdNet | None:
    """Find the order of inputs and the meaning of the output with which the weights denoise, or None."""
    clean = torch.from_numpy(_probe_image()).float().expand(1, network.channels, -1, -1)
    noise = np.random.default_rng(0).normal(0, _PROBE_SIGMA, clean.shape)
    noisy, sigma = clean + torch.from_numpy(noise).float(), torch.tensor([_PROBE_SIGMA])
    best, least = None, _PROBE_SHARE_LEFT * _PROBE_SIGMA
    for map_first, predicts_noise in product((False, True), repeat=2):
        candidate = replace(network, map_first=map_first, predicts_noise=predicts_noise)
        with torch.no_grad():
            left = float((candidate(noisy, sigma) - clean).square().mean().sqrt())
        if left < least:  # false for NaN
            best, least = candidate, left
    return best


def _probe_image() -> F64:
    y, x = np.mgrid[:64, :64] / 64
    disc = np.hypot(x - 0.4, y - 0.6) < 0.25
    return 0.3 + 0.3 * x + 0.1 * np.sin(6 * y) + 0.2 * disc
