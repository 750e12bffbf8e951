"""Does a geometry without tracks find motions, and no motion for a camera at rest?

    python -m tests.benchmarks direct

For scenes and numbers of views, and a camera that moves, stays or only rotates: the result of the tracks; the uniform
motion, its residual as a multiple of those of the tracks' geometry and of a camera at rest, and the error of its
rotations; and the residual of the true path, whose depths are estimated without tracks as well.
"""

from itertools import product

from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.evidence import unexplained
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.geometry.sources.direct import Direct, at_rest
from gs2ci.reconstruct.geometry.sources.sources import uniform_motion
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from tests.stability.benches import Bench, ahead, still, turning

SCENES = ("boxes", "thicket", "motorcycle", "ball")
SIZE = (96, 128)
PATHS = {
    "moves": None,
    "forwards": ahead(0.2),
    "at rest": still,
    **{f"turns by {degrees:g}°": turning(degrees) for degrees in (0.5, 3, 10)},
}
VIEWS = (8, 16, 32)
SEED = 0


def run() -> None:
    print(f"{'':34} {'tracks':>13} {'uniform':>13} {'of tracks':>9} {'of rest':>8} {'turn, °':>8} {'true path':>9}")
    for scene, (path, camera), views in product(SCENES, PATHS.items(), VIEWS):
        shot = Bench(scene=scene, path=camera, views=views).expose(SIZE)
        print(f"{f'{scene}, {views} views, {path}':34} {_found(shot)}", flush=True)


def _found(shot: Shot) -> str:
    settings = Settings()
    seen = Holdout.of(shot, settings.fit.hold_out.share, SEED).seen
    request = Request.of(seen, gap_tv(seen, settings.decode, Silent()), settings.geometry, None)
    tracks = from_tracks(request, Silent())
    uniform = uniform_motion(request, tracks)
    rest = at_rest(tracks)
    truth = shot.truth.world_to_camera
    assert truth is not None
    along = Direct(request, tracks).along(truth)

    def left(geometry: Geometry) -> float:
        return unexplained(seen, request.views, geometry)

    turn_deg = trajectory_errors(uniform.world_to_camera, truth).rpe_r_deg
    told = "none" if along is None else f"{left(along) / left(rest):.3f}"
    shares = f"{left(uniform) / left(tracks):9.3f} {left(uniform) / left(rest):8.3f}"
    return f"{tracks.verdict:>13} {uniform.verdict:>13} {shares} {turn_deg:8.3f} {told:>9}"
