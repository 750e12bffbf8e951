import numpy as np
import pytest

from gs2ci.core.errors import NumericsError
from gs2ci.reconstruct.paper.priors2d.base import check_targets

IMAGES = np.full((2, 4, 5, 3), 0.5, np.float32)


def test_targets_are_clamped_to_what_a_view_can_show():
    targets = check_targets("it", IMAGES * 4 - 1.5, IMAGES)
    assert targets.dtype == np.float32
    assert (targets.min(), targets.max()) == (0.5, 0.5)
    assert check_targets("it", IMAGES + 9, IMAGES).max() == 1


def test_targets_of_another_shape_are_refused():
    with pytest.raises(NumericsError, match=r"the prior it made \[1, 4, 5, 3\] of images \[2, 4, 5, 3\]"):
        check_targets("it", IMAGES[:1], IMAGES)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_targets_that_are_not_finite_are_refused(value):
    targets = IMAGES.copy()
    targets[1, 2, 3] = value
    with pytest.raises(NumericsError, match="not finite"):
        check_targets("it", targets, IMAGES)
