"""The approximation error of the solver's rasteriser against the simulator's ray tracing, on scenes of the library.

Readings are those of one open mask with the rig's standard light and sensor (991 DN at white), from the scenes' own
cameras at 96 x 128 px. The rasteriser draws two samples per pixel side, as plans do, and four and eight; the rays are
four per side, and the last column is their difference from eight.
"""

import time

import numpy as np

from gs2ci_sims.exact import ExactRenderer
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.scenes.files import load_scene, scene_names

SIZE = (96, 128)
SAMPLES = (2, 4, 8)


def run() -> None:
    """Print a row per scene."""
    rig = RigFigures()
    white_dn = rig.full_scale_e * rig.dn_per_e
    columns = "".join(f"{f'{samples} x {samples}, DN':>12}{'dB':>7}" for samples in SAMPLES)
    print(f"{white_dn:.0f} DN at white; rms over the pixels")
    print(f"{'scene':<14}{'Gaussians':>10}{columns}{'rays, s':>9}{'raster, s':>10}{'8 rays, DN':>12}")
    for name in scene_names():
        scene = load_scene(name, size=SIZE).scene
        if scene.mesh is not None:
            continue
        pose = scene.world_to_camera[None]
        ExactRenderer(1).views(scene, pose)  # compiles
        began_s = time.perf_counter()
        truth = ExactRenderer().views(scene, pose)[0][0]
        exact_s = time.perf_counter() - began_s
        row = ""
        seconds = []
        for samples in SAMPLES:
            began_s = time.perf_counter()
            view = Renderer(samples).views(scene, pose)[0][0]
            seconds.append(time.perf_counter() - began_s)
            rms = float(np.sqrt(np.square(view - truth, dtype=np.float64).mean()))
            row += f"{white_dn * rms:>12.2f}{-20 * np.log10(rms):>7.1f}"
        finer = ExactRenderer(8).views(scene, pose)[0][0]
        left = white_dn * float(np.sqrt(np.square(finer - truth, dtype=np.float64).mean()))
        print(f"{name:<14}{len(scene.gaussians):>10}{row}{exact_s:>9.2f}{seconds[0]:>10.3f}{left:>12.2f}", flush=True)
