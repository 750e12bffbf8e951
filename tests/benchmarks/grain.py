"""How grainy a moving image is by each renderer of the simulator: what is no light, and would go away with more views.

Views follow each other by a tenth of a pixel, and what of each pixel no cubic follows is grain, as the planner measures
it (`gs2ci_sims.grain`): rms, as a share of full scale. It decides whether rays could stand in where grain decides.
"""

import time

import numpy as np

from gs2ci_sims.exact import ExactRenderer
from gs2ci_sims.grain import DEGREE, LENGTH_PX, VIEWS_EACH
from gs2ci_sims.path import stage_move_for_parallax
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.scenes.files import load_scene

SIZE = (48, 64)
PARALLAX_PX = 3.0
EXPOSURE_S = 1.0
MIDDLES = (-0.3, 0.0, 0.3)
RENDERERS = {
    "rasteriser, 2 x 2": Renderer(),
    "rasteriser, 4 x 4": Renderer(supersampling=4),
    "rays, 2 x 2": ExactRenderer(supersampling=2),
    "rays, 4 x 4": ExactRenderer(),
    "rays, 8 x 8": ExactRenderer(supersampling=8),
}


def run() -> None:
    """Print grain and processor seconds a view, per scene and renderer."""
    steps = np.linspace(-1, 1, VIEWS_EACH)
    beyond = np.linalg.qr(np.vander(steps, DEGREE + 1), mode="complete")[0][:, DEGREE + 1 :]
    print(f"{'scene':10} {'samples a pixel':20} {'grain':>9} {'s a view':>9}")
    for name in ("planes", "boxes"):
        scene = load_scene(name, size=SIZE).scene
        path = stage_move_for_parallax(scene, PARALLAX_PX, EXPOSURE_S, wobble_deg=0.0)
        for label, renderer in RENDERERS.items():
            squares, began_s = [], time.process_time()
            for middle in MIDDLES:
                moments_s = EXPOSURE_S * (middle + 0.5 * LENGTH_PX / PARALLAX_PX * steps)
                views = renderer.views(scene, path.world_to_camera(moments_s))[0].astype(np.float64)
                squares.append(np.square(np.tensordot(beyond.T, views, axes=1)).mean())
            seconds = (time.process_time() - began_s) / (len(MIDDLES) * VIEWS_EACH)
            print(f"{name:10} {label:20} {np.sqrt(np.mean(squares)):9.1e} {seconds:9.3f}")
