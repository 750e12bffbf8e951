"""From the simulator to a decoder in an ONNX file: a tiny network is trained on simulated exposures, against GAP-TV.

    python -m tests.benchmarks.small_network FILE [STEPS]   trains, writes FILE, decodes a scene that it has not seen
    gs2ci decode shot.h5 --method onnx:FILE

Here: the network, its training, its export. It only demonstrates the procedure: three unrolled steps of projection and
three-dimensional convolution, 15,627 numbers, three minutes of one processor. The exposures are those of the
light path (moving camera, read noise, quantisation), coded by random masks; each colour is one grey example. Scenes of
training and of judging are different ones.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.learned.onnx_models import trace
from gs2ci.reconstruct.learned.onnx_video_decoder import OnnxVideoDecoder
from tests.tables.cases import Case

TRAINED_ON: Final = ("boxes", "thicket", "corridor", "ball", "planes")
JUDGED_ON: Final = ("motorcycle", "blocks")
SIZE: Final = (96, 128)
STEPS: Final = 600


class SmallNetwork(nn.Module):
    """Projection onto the measurement and convolution, in turn; the signature is that of `OnnxVideoDecoder`.

    Args:
        stages: How often.
        width: Channels of the convolutions.
    """

    def __init__(self, stages: int = 3, width: int = 12) -> None:
        super().__init__()
        self.stages = nn.ModuleList(
            nn.Sequential(
                nn.Conv3d(3, width, 3, padding=1),
                nn.ReLU(),
                nn.Conv3d(width, width, 3, padding=1),
                nn.ReLU(),
                nn.Conv3d(width, 1, 3, padding=1),
            )
            for _ in range(stages)
        )

    def forward(self, y: Tensor, phi: Tensor, total: Tensor) -> Tensor:
        """Decode y [B, 1, H, W] behind phi [B, N, H, W], whose sum is total [B, 1, H, W]; views [B, N, H, W]."""
        average = (y / total).expand_as(phi)
        energy = (phi * phi).sum(dim=1, keepdim=True).clamp(min=1e-3)
        views = average
        for stage in self.stages:
            views = views + phi * ((y - (phi * views).sum(dim=1, keepdim=True)) / energy)
            views = views + stage(torch.stack([views, phi, average], dim=1))[:, 0]
        return views


def examples(shots: Sequence[Shot], count: int, side: int, generator: torch.Generator) -> tuple[Tensor, ...]:
    """Cut `count` squares out of shots with truth: y, phi, total and views, each colour by itself."""

    def drawn(most: int) -> int:
        return int(torch.randint(most, (1,), generator=generator))

    parts = []
    for _ in range(count):
        shot = shots[drawn(len(shots))]
        assert shot.truth.views is not None
        row, column = (drawn(had - side + 1) for had in shot.size)
        square, colour = np.s_[row : row + side, column : column + side], drawn(shot.measurement.shape[2])
        masks = (shot.masks * shot.weights[:, None, None])[(slice(None), *square)]
        y = shot.measurement[(*square, colour)][None]
        parts.append((y, masks, masks.sum(axis=0, keepdims=True), shot.truth.views[(slice(None), *square, colour)]))
    y, masks, total, views = (torch.from_numpy(np.stack(arrays)).float() for arrays in zip(*parts, strict=True))
    return y, masks, torch.where(total == 0, torch.ones(()), total), views


def train(network: nn.Module, shots: Sequence[Shot], steps: int, *, side: int = 40, at_once: int = 4) -> list[float]:
    """Train a network by the mean square error of its views; returns that of each step."""
    generator = torch.Generator().manual_seed(0)
    optimiser = torch.optim.Adam(network.parameters(), lr=2e-3)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    errors = []
    for _ in range(steps):
        *given, views = examples(shots, at_once, side, generator)
        loss = (network(*given) - views).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        falling.step()
        errors.append(float(loss.detach()))
    return errors


def export(network: nn.Module, path: Path) -> Path:
    """Write a network as ONNX with open views, height and width."""
    given = (torch.rand(1, 1, 16, 24), torch.rand(1, 5, 16, 24), torch.ones(1, 1, 16, 24))
    plane = {2: "height", 3: "width"}
    axes = {"y": plane, "phi": {1: "views", **plane}, "total": plane, "views": {1: "views", **plane}}
    trace(network, dict(zip(("y", "phi", "total"), given, strict=True)), ["views"], axes, str(path))
    return path


def run(path: Path, steps: int = STEPS) -> None:
    began_s, busy_s = time.perf_counter(), time.process_time()
    shots = [Case(name, scene=name, size=SIZE).shot(seed) for name in TRAINED_ON for seed in range(3)]
    print(f"{len(shots)} exposures of {', '.join(TRAINED_ON)}, {time.process_time() - busy_s:.0f} s of processors")
    torch.manual_seed(0)
    network = SmallNetwork()
    errors = train(network, shots, steps)
    decode = OnnxVideoDecoder(export(network, path))
    numbers = sum(parameter.numel() for parameter in network.parameters())
    print(
        f"{numbers} numbers, {steps} steps: mean square error {np.mean(errors[:20]):.5f} at first, "
        f"{np.mean(errors[-20:]):.5f} at last; {time.perf_counter() - began_s:.0f} s, "
        f"{time.process_time() - busy_s:.0f} s of processors, {path.stat().st_size} bytes"
    )
    print("scene        average  GAP-TV  network   (PSNR, dB; scenes that it has not seen)")
    for name in JUDGED_ON:
        shot = Case(name, scene=name, size=SIZE).shot(7)
        assert shot.truth.views is not None
        exposure = np.maximum(shot.masks.sum(axis=0), 1)[..., None]
        average = np.repeat((shot.measurement / exposure)[None], shot.views, axis=0).astype(np.float32)
        views = (average, gap_tv(shot, GapTvSettings()), decode(shot))
        average_db, tv_db, network_db = (np.mean(psnr_per_view(one, shot.truth.views)) for one in views)
        print(f"{name:12s} {average_db:7.2f} {tv_db:7.2f}  {network_db:7.2f}", flush=True)


if __name__ == "__main__":
    run(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else STEPS)
