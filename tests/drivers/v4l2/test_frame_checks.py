import pytest

from gs2ci_drivers.v4l2 import abi
from gs2ci_drivers.v4l2.formats import PIXEL_FORMATS, FrameGeometry
from gs2ci_drivers.v4l2.frame_checks import KernelFrameChecks, TakenBuffer
from gs2ci_drivers.v4l2.node import Dequeued

GEOMETRY = FrameGeometry(PIXEL_FORMATS["GREY"], 4, 2, 4, 8)


def taken(number):
    buffer = Dequeued(0, 8, 0, abi.BufferFlag.TIMESTAMP_MONOTONIC, 1_000_000, number)
    return TakenBuffer(buffer, bytes(8), 0)


@pytest.mark.parametrize("behind", [1, 2, 7])
def test_a_frame_passed_over_that_came_out_of_order_does_not_count_billions(behind):
    checks = KernelFrameChecks("cam0", GEOMETRY, (0,), 0)
    for number in range(10):
        checks.pass_over(taken(number))
    checks.pass_over(taken(10 - behind))
    assert checks.frame_index == 10


def test_frames_passed_over_are_counted_across_the_wrap_of_their_numbers():
    checks = KernelFrameChecks("cam0", GEOMETRY, (), 0)
    for number in (2**32 - 2, 2**32 - 1, 0, 1):
        checks.pass_over(taken(number))
    assert checks.frame_index == 3
    assert checks.check(taken(2), 0).sequence == 3
