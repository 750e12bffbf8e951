"""Several exposures written as one measurement."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci.core.summed import in_one_frame, summed

SIZE = (6, 8)


def shot(seed: int, views: int = 3, **changes: object) -> Shot:
    rng = np.random.default_rng(seed)
    truth = rng.random((views, *SIZE, 1), dtype=np.float32)
    masks = (rng.random((views, *SIZE)) < 0.5).astype(np.float32)
    made = Shot(
        np.einsum("nhw,nhwc->hwc", masks, truth),
        masks,
        intrinsics=np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]),
        truth=Truth(truth),
        name=f"shot {seed}",
    )
    return replace(made, **changes)


def test_the_sum_is_coded_by_the_masks_of_all():
    both = summed([shot(0), shot(1, views=2)], "both").check()
    assert (both.views, both.name) == (5, "both")
    coded = np.einsum("nhw,nhwc->hwc", both.masks, both.truth.views)
    np.testing.assert_allclose(both.measurement, coded, atol=1e-5)
    assert both.provenance["exposures"] == ["shot 0", "shot 1"]


def test_what_one_exposure_lacks_the_sum_lacks():
    poses = np.tile(np.eye(4), (3, 1, 1))
    one = shot(0, telemetry_world_to_camera=poses, saturated=np.ones(SIZE, bool))
    both = summed([one, shot(1, truth=Truth())], "both")
    assert both.truth.views is None
    assert both.telemetry_world_to_camera is None
    assert both.saturated is not None
    assert both.saturated.all()


def test_one_exposure_is_its_own_sum():
    only = summed([shot(0)], "only")
    assert np.array_equal(only.measurement, shot(0).measurement)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"intrinsics": None}, "camera matrix"),
        ({"measurement": np.zeros((6, 8, 3)), "truth": Truth()}, "number of colour channels"),
        ({"cfa": "RGGB", "truth": Truth()}, "number of colour channels"),
        ({"distortion": np.zeros(5)}, "distortion"),
    ],
)
def test_exposures_of_several_cameras_are_refused(changes, said):
    with pytest.raises(InputError, match=said):
        summed([shot(0), shot(1, **changes)], "both")


def test_nothing_has_no_sum():
    with pytest.raises(InputError, match="no exposures"):
        summed([], "none")


def staged(seed: int, centre: float, origin: object) -> Shot:
    """Return an exposure whose stage had the camera at a place of its frame, turned by a quarter about its axis."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    poses[:, :3, 3] = -poses[:, :3, :3] @ [centre, 0.0, 0.0]
    telemetry = {"axes_from": "[stage.mount]"} | ({} if origin is None else {"origin": origin})
    return shot(seed, telemetry_world_to_camera=poses, provenance={"source": "rig", "telemetry": telemetry})


def centres(one: Shot) -> np.ndarray:
    poses = one.telemetry_world_to_camera
    return -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])


def test_captures_of_one_stage_share_the_frame_of_the_first():
    first, without, second = staged(0, 1.0, [65.0, 2.0, 0.0]), shot(1), staged(2, 1.5, [75.0, 5.0, -1.0])
    found = in_one_frame([first, without, second])
    assert found[0] is first
    assert found[1] is without
    assert centres(found[2]) == pytest.approx(np.tile([11.5, 3.0, -1.0], (3, 1)))
    assert found[2].telemetry_world_to_camera[:, :3, :3] == pytest.approx(second.telemetry_world_to_camera[:, :3, :3])
    # What is in one frame stays there.
    again = in_one_frame(found)
    assert [one is other for one, other in zip(again, found, strict=True)] == [True, True, True]


def test_poses_without_a_stated_origin_are_taken_to_be_in_one_frame():
    shots = [staged(0, 1.0, [65.0, 0.0, 0.0]), staged(1, 1.5, None)]
    assert in_one_frame(shots) is shots


@pytest.mark.parametrize("stated", [[1.0, 2.0], "here", [0.0, 0.0, float("nan")]])
def test_an_origin_is_three_numbers(stated):
    with pytest.raises(InputError, match="shot 1 states an origin"):
        in_one_frame([staged(0, 0.0, [0.0, 0.0, 0.0]), staged(1, 0.0, stated)])
