"""Does the measurement detect wrong stage poses? First geometries by right and wrong poses of a stage, and by tracks.

    python -m tests.benchmarks stage_poses

For each scene: what tracks alone find. Then, for poses of a stage that err in a known way, what the stage's geometry
leaves of the measurement, as a multiple of what the tracks leave; which of them `auto` takes; and its errors against
the true path. A direction of travel that errs towards the depth is what neither a picture nor the tracks can tell.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.errors import GeometryError
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.evidence import unexplained
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from tests.tables.case_sets import SIMULATED, TEXTURELESS
from tests.tables.cases import Case, staged

SEED = 0


def _places_off(share: float) -> Callable[[Shot], Shot]:
    return lambda shot: staged(shot, share, np.random.default_rng(SEED))


def _mount_off(axis: str, angle_deg: float) -> Callable[[Shot], Shot]:
    """Turn the direction of travel in the middle camera's frame; the camera's own directions stay."""
    turn = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()

    def told(shot: Shot) -> Shot:
        poses = _from_the_middle(shot)
        places = np.linalg.inv(poses)[:, :3, 3] @ turn.T
        poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], places)
        return replace(shot, telemetry_world_to_camera=poses)

    return told


def _pans(angle_deg: float) -> Callable[[Shot], Shot]:
    """Report a turn to the side that the camera did not make, of so much from the first view to the last."""

    def told(shot: Shot) -> Shot:
        poses = _from_the_middle(shot)
        along = np.arange(shot.views) / (shot.views - 1) - 0.5
        turns = np.tile(np.eye(4), (shot.views, 1, 1))
        turns[:, :3, :3] = Rotation.from_rotvec(along[:, None] * (0, angle_deg, 0), degrees=True).as_matrix()
        return replace(shot, telemetry_world_to_camera=turns @ poses)

    return told


def _from_the_middle(shot: Shot) -> F64:
    poses = shot.truth.world_to_camera
    assert poses is not None
    relative: F64 = poses @ np.linalg.inv(poses[shot.views // 2])
    return relative


REPORTS: dict[str, Callable[[Shot], Shot]] = {
    "exact": _places_off(0.0),
    **{f"places off by {percent} %": _places_off(percent / 100) for percent in (1, 5, 20)},
    **{f"travel {angle}° off, to the depth": _mount_off("y", angle) for angle in (5, 20)},
    **{f"travel {angle}° off, in the image": _mount_off("z", angle) for angle in (5, 10, 20, 180)},
    **{f"a pan of {angle}°": _pans(angle) for angle in (0.2, 1)},
}


def _ask(name: str, request: Request) -> Geometry:
    return load_geometry_prior(name)(request, Silent())


def _errors(geometry: Geometry, shot: Shot) -> str:
    assert shot.truth.world_to_camera is not None
    found = trajectory_errors(geometry.world_to_camera, shot.truth.world_to_camera)
    return f"{found.nate:8.4f} {found.rotation_deg:7.2f}"


def run() -> None:
    settings = Settings()
    print(f"{'':44} {'left':>7} {'taken':>8} {'nATE':>8} {'turn, °':>7}")
    for name in (*SIMULATED, TEXTURELESS):
        shot = Case(name, scene=name).shot(SEED)
        holdout = Holdout.of(shot, settings.fit.hold_out.share, SEED)
        views = gap_tv(holdout.seen, settings.decode, Silent())
        plain = Request.of(holdout.seen, views, settings.geometry, None)
        tracks = _ask("tracks", plain)
        left = unexplained(plain.shot, views, tracks)
        print(f"{name + ', tracks alone':44} {1:7.3f} {'':8} {_errors(tracks, shot)}")
        for report, told in REPORTS.items():
            request = replace(plain, shot=told(holdout.seen))
            try:
                share = f"{unexplained(plain.shot, views, _ask('stage', request)) / left:.3f}"
            except GeometryError:
                share = "refused"
            taken = _ask("auto", request)
            print(f"    {report:40} {share:>7} {taken.source:>8} {_errors(taken, shot)}", flush=True)
