"""Which results are the same on every processor? One exposure simulated and reconstructed as on each, stage by stage.

    python -m tests.benchmarks processors

Each processor is emulated (`tests.processors`) in its own process. A stage is the same if its bits are those of this
machine; otherwise the root mean square difference is printed as a share of the stage's own rms. For comparison follows
the difference that another seed makes on this machine: a smaller one is within the scatter of fits.
"""

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct import observe, pipeline
from gs2ci.reconstruct.settings import Settings
from tests.stability.benches import Bench

PROCESSORS = ("haswell", "nehalem")  # AVX2, SSE4.2
SCENES = ("boxes", "motorcycle")
SIZE = (48, 64)
SEEDS = (0, 1)
SETTINGS = Settings(fits=1, look_again=False)
STAGES = ("measurement", "decode", "first path", "first depth", "path", "views", "depth")


def run() -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = {"this machine": _as_on([], Path(folder) / "here.npz")}
        for name in PROCESSORS:
            found[name] = _as_on(["-m", "tests.processors", name], Path(folder) / f"{name}.npz")
    here = found["this machine"]
    for name in PROCESSORS:
        for scene in SCENES:
            told = [f"{stage} {_difference(found[name], here, scene, 0, 0, stage)}" for stage in STAGES]
            print(f"{name:10} {scene:11} {', '.join(told)}; {_psnr(found[name], scene)}", flush=True)
    for scene in SCENES:
        told = [f"{stage} {_difference(here, here, scene, 1, 0, stage)}" for stage in STAGES]
        print(f"{'other seed':10} {scene:11} {', '.join(told)}; {_psnr(here, scene)}", flush=True)


def _as_on(player: list[str], out: Path) -> dict[str, np.ndarray]:
    subprocess.run([sys.executable, *player, "-m", "tests.benchmarks.processors", str(out)], check=True)
    with np.load(out) as data:
        return dict(data)


def _difference(one: dict[str, np.ndarray], other: dict[str, np.ndarray], scene: str, *keys: object) -> str:
    seed, than, stage = keys
    a, b = one[f"{scene} {seed} {stage}"], other[f"{scene} {than} {stage}"]
    if np.array_equal(a, b):
        return "same"
    return f"{np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)):.1e}"


def _psnr(one: dict[str, np.ndarray], scene: str) -> str:
    return " and ".join(f"{float(one[f'{scene} {seed} psnr']):.2f}" for seed in SEEDS) + " dB"


def _stages(scene: str, seed: int) -> dict[str, np.ndarray]:
    looked, shot = [], Bench(scene=scene).expose(SIZE)
    first_look = observe.look
    observe.look = lambda *parts: looked.append(first_look(*parts)) or looked[-1]
    try:
        result = pipeline.reconstruct(shot, replace(SETTINGS, seed=seed)).result
    finally:
        observe.look = first_look
    first = looked[0]
    return {
        "measurement": shot.measurement,
        "decode": first.decoded,
        "first path": _centres(first.geometry.world_to_camera),
        "first depth": 1 / first.geometry.inverse_depth,
        "path": _centres(result.world_to_camera),
        "views": result.views,
        "depth": result.depth,
        "psnr": np.mean(psnr_per_view(result.views, shot.truth.views)),
    }


def _centres(world_to_camera: np.ndarray) -> np.ndarray:
    return np.linalg.inv(world_to_camera)[:, :3, 3]


if __name__ == "__main__":
    every = {(scene, seed): _stages(scene, seed) for scene in SCENES for seed in SEEDS}
    np.savez(
        sys.argv[1], **{f"{scene} {seed} {key}": a for (scene, seed), one in every.items() for key, a in one.items()}
    )
