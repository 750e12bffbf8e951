"""Several exposures written as one measurement."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci.core.summed import summed

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
