"""Names in the order of their numbers."""

import numpy as np
import pytest

from gs2ci.core.natural_order import natural_order


def ordered(names):
    return [names[index] for index in natural_order(names).indices]


@pytest.mark.parametrize(
    "names",
    [
        [f"z_{k}mm.png" for k in range(-4, 4)],
        [f"{k}.tif" for k in range(-12, 12, 3)],
        [f"pos={k} um.png" for k in (-100, -20, -3, 0, 4, 50)],
        [f"view{k}.png" for k in range(-2, 3)],
        [f"x_-{k}.png" for k in (12, 9, 3)],
        [f"z_{k:.2f}mm.png" for k in (-0.5, -0.25, 0, 0.25, 0.5, 10)],
        [f"z_{k}mm.png" for k in (-0.5, -0.25, 0, 0.25, 0.5, 10)],
        [f"images/{k}/a.png" for k in (-2, -1, 10)],
        ["scan-1-9.png", "scan-1-10.png", "scan-2-1.png"],
        ["img-001.png", "img-002.png", "img-010.png"],
        ["2024-01-09.png", "2024-01-10.png", "2024-02-01.png"],
        ["mask9.png", "mask10.png", "mask11.png"],
        ["9.jp2", "10.jp2"],
        ["1.5um.tif", "1.25um.tif"][::-1],
        [f"z_−{k}.png" for k in (3, 1)] + ["z_0.png"],
        ["a", "b"],
    ],
)
def test_numbers_decide_and_a_sign_is_a_sign(names):
    """F6: the order was 4 5 6 7 3 2 1 0, silent."""
    shuffled = [names[k] for k in np.random.default_rng(0).permutation(len(names))]
    assert ordered(shuffled) == names
    assert not natural_order(names).is_doubtful


def test_whole_numbers_decide_between_points_that_may_be_versions_and_it_is_said():
    assert ordered(["run1.10.png", "run1.9.png"]) == ["run1.9.png", "run1.10.png"]
    assert natural_order(["run1.10.png", "run1.9.png"]).is_doubtful
    assert not natural_order(["run1.1.png", "run1.2.png"]).is_doubtful


@pytest.mark.parametrize("seed", range(20))
def test_drawn_names_of_positions_come_in_the_order_of_the_positions(seed):
    rng = np.random.default_rng(seed)
    head = str(rng.choice(["", "z_", "pos=", "view ", "stage_z", "cam"]))
    unit = str(rng.choice(["", "mm", "um", "deg"]))
    digits = int(rng.integers(0, 4))
    places = np.unique(np.round(rng.uniform(-50, 50, 12), digits))
    names = [f"{head}{place + 0.0:.{digits}f}{unit}.png" for place in places]
    if not any("-" in name for name in names):
        return
    shuffled = [names[k] for k in rng.permutation(len(names))]
    assert ordered(shuffled) == names
