"""Decoders against their published figures: the grayscale video benchmark, every measurement of a file.

It uses data and weights that we may not distribute: `GS2CI_SHARED_DATA`, or `../shared/data` beside the checkout,
with `video_sci/*.mat` and `weights/ffdnet_gray.pth`; missing files are skipped, with the reason. PSNR is the mean over
all frames. GAP-TV runs as published (weight 0.3, 40 iterations of 5 steps), and with total variation along the views,
whose strength is chosen by held-out pixels; FFDNet at sigma 50, 25, 12, 6 of 255, 10 iterations each.
"""

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view, ssim_per_view
from gs2ci.reconstruct.decode.denoisers import TotalVariation
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, choose_coupling, gap_tv
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, plug_and_play
from gs2ci.reconstruct.learned.ffdnet import export_ffdnet, read_ffdnet
from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser

FILES = {"runner": "runner40_cacti.mat", "drop": "drop40_cacti.mat", "traffic": "traffic48_cacti.mat"}
PUBLISHED = {
    "GAP-TV": {"runner": 30.13, "drop": 34.50, "traffic": 20.65},
    "PnP-GAP FFDNet": {"runner": 32.66, "drop": 39.82, "traffic": 23.89},
}
AS_PUBLISHED = GapTvSettings(weight=0.3)

_Decoder = Callable[[Shot], F32]


def data_folder() -> Path:
    """Say where data lie that are not ours to give."""
    return Path(os.environ.get("GS2CI_SHARED_DATA", Path(__file__).resolve().parents[2].parent / "shared" / "data"))


def run() -> None:
    data = data_folder()
    if not (data / "video_sci").is_dir():
        print("skipped: no video_sci in GS2CI_SHARED_DATA or ../shared/data")
        return
    print(
        f"{torch.get_num_threads()} threads\nfile     decoder             measured   PSNR  published    SSIM  seconds"
    )
    decoders: dict[str, tuple[_Decoder, str]] = {
        "GAP-TV": (lambda shot: gap_tv(shot, AS_PUBLISHED), "GAP-TV"),
        "GAP-TV coupled": (lambda shot: gap_tv(shot, choose_coupling(shot, AS_PUBLISHED, 0)), "GAP-TV"),
        "PnP-GAP TV": (_plugged(TotalVariation()), ""),
    }
    with tempfile.TemporaryDirectory() as folder:
        network = ffdnet(data / "weights" / "ffdnet_gray.pth", Path(folder))
        if network is not None:
            decoders["PnP-GAP FFDNet"] = (_plugged(network), "PnP-GAP FFDNet")
        for name, file in FILES.items():
            if not (data / "video_sci" / file).is_file():
                print(f"{name:8s} skipped: no {file}")
                continue
            shots = import_shots(data / "video_sci" / file, None, ImportOptions()).shots
            for decoder, (decode, peer) in decoders.items():
                _row(name, decoder, decode, shots, PUBLISHED.get(peer, {}).get(name))


def _plugged(denoise: TotalVariation | OnnxDenoiser) -> _Decoder:
    return lambda shot: np.clip(plug_and_play(shot, denoise, PlugAndPlaySettings()), 0, 1)


def ffdnet(weights: Path, folder: Path) -> OnnxDenoiser | None:
    """Export the user's weights and load them; None, with the reason printed, where there are none."""
    try:
        return OnnxDenoiser(export_ffdnet(read_ffdnet(weights), folder / "ffdnet.onnx"))
    except InputError as error:
        print(f"FFDNet skipped: {error.problem}")
        return None


def _row(name: str, decoder: str, decode: _Decoder, shots: list[Shot], published: float | None) -> None:
    psnr: list[float] = []
    ssim: list[float] = []
    seconds = 0.0
    for shot in shots:
        started = time.perf_counter()
        views = decode(shot)
        seconds += time.perf_counter() - started
        assert shot.truth.views is not None
        psnr += psnr_per_view(views, shot.truth.views)
        ssim += ssim_per_view(views, shot.truth.views)
    peer = "" if published is None else f"{published:.2f}"
    print(
        f"{name:8s} {decoder:18s} {len(shots)} shots  {np.mean(psnr):6.2f} {peer:>10s}  {np.mean(ssim):6.4f}  "
        f"{seconds:7.1f}",
        flush=True,
    )
