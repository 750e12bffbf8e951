"""Decoders without and with trained weights on the grayscale video benchmark, every measurement of every file.

    python -m tests.benchmarks video                        files of GS2CI_SHARED_DATA or ../shared/data
    python -m tests.benchmarks.video FOLDER [FIRST] [DECODER ...]   all .mat files of a folder; of each the FIRST
                                                            measurements (0: all); decoders by name, or all of them

Files are those of the published benchmark (`mask`, `meas`, `orig`) and not ours to give. PSNR is the mean over all
frames of views in [0, 1]. FFDNet needs its weights, `weights/ffdnet_gray.pth` beside the folder. Processor seconds are
of all threads together: divided by the processors that stand idle they are what a decode takes at least.
`patches-5s` has
five seconds by the clock: its figures say nothing where others work on the machine.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view, ssim_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import decode_until, patch_decode
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, plug_and_play
from tests.benchmarks.decoders import AS_PUBLISHED, data_folder, ffdnet

_Decoder = Callable[[Shot], F32]


def run(folder: Path | None = None, first: int | None = None, wanted: Sequence[str] = ()) -> None:
    folder = folder or data_folder() / "video_sci"
    files = sorted(folder.glob("*.mat"))
    if not files:
        print(f"skipped: no .mat file in {folder}")
        return
    print(
        f"{torch.get_num_threads()} threads; seconds by the clock and of processors, each for one measurement\n"
        "file             decoder              shots    PSNR    SSIM    clock  processors"
    )
    decoders: dict[str, _Decoder] = {
        "gap-tv": lambda shot: gap_tv(shot, AS_PUBLISHED),
        "patches-quick": lambda shot: patch_decode(shot, PatchSettings.quick()),
        "patches": patch_decode,
        "patches-5s": lambda shot: decode_until(shot, time.monotonic() + 5).views,
    }
    with tempfile.TemporaryDirectory() as scratch:
        weights = folder.parent / "weights" / "ffdnet_gray.pth"
        network = ffdnet(weights, Path(scratch)) if not wanted or any("ffdnet" in name for name in wanted) else None
        if network is not None:
            as_authors = PlugAndPlaySettings(begin="transpose")
            decoders["pnp-ffdnet"] = lambda shot: np.clip(plug_and_play(shot, network, PlugAndPlaySettings()), 0, 1)
            decoders["pnp-ffdnet-published"] = lambda shot: plug_and_play(shot, network, as_authors)
        for file in files:
            shots = import_shots(file, None, ImportOptions()).shots[:first]
            for name, decode in decoders.items():
                if wanted and name not in wanted:
                    continue
                _row(file.stem, name, decode, shots)


def _row(file: str, name: str, decode: _Decoder, shots: list[Shot]) -> None:
    psnr: list[float] = []
    ssim: list[float] = []
    began_s, processors_s = time.perf_counter(), time.process_time()
    for shot in shots:
        views = decode(shot)
        assert shot.truth.views is not None
        psnr += psnr_per_view(views, shot.truth.views)
        ssim += ssim_per_view(views, shot.truth.views)
    seconds, busy_s = (time.perf_counter() - began_s) / len(shots), (time.process_time() - processors_s) / len(shots)
    print(
        f"{file:16s} {name:20s} {len(shots):5d}  {np.mean(psnr):6.2f}  {np.mean(ssim):6.4f}  {seconds:7.1f}  "
        f"{busy_s:10.1f}",
        flush=True,
    )


if __name__ == "__main__":
    run(Path(sys.argv[1]), int(sys.argv[2]) or None if len(sys.argv) > 2 else None, sys.argv[3:])
