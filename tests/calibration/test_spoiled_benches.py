"""Every way of spoiling a bench that users will find, and the reason with which calibration must refuse it."""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace

import pytest

from gs2ci.rig.config import RigTable
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.geometry import stage
from gs2ci_calibration.procedures import PROCEDURES
from gs2ci_calibration.refusals import CalibrationError, Reason
from tests.bench_truth import opened
from tests.benchmarks.calibration_geometry import random_bench

pytestmark = pytest.mark.slow

BOARD_SIZE = (160, 200)


def masks_table(**world):
    """A rig whose masks can be calibrated in a moment."""
    return RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {"kind": "v4l2", "format": "Y12", "black_level_dn": 64.0},
            "capture": {"masks": 4, "density": 0.5, "mask_s": 0.004},
            "registration": {"superpixel": 2},
            "optics": {"full_scale_e_per_s": 2e6},
            "calibration": {"frames": 8, "mask_frames": 4},
            "world": {"scene": "planes", "height": 48, "width": 64} | world,
        }
    )


@contextmanager
def masks_bench(**world):
    """Open a bench of the steps that look at masks and light."""
    with opened(masks_table(**world)) as (bench, _):
        yield bench


@contextmanager
def board_bench(**world):
    """Open a bench of the steps that look at a board."""
    bench, _, _ = random_bench(3, BOARD_SIZE, ("x",), devices="typical", **world)
    try:
        yield replace(bench, options=bench.options.model_copy(update={"board_views": 8}))
    finally:
        bench.devices.close()


def swap_two_masks(bench):
    """Let the modulator show the third pattern of every upload in the place of the fourth, and the other way round."""
    modulator = bench.devices.modulator
    send = modulator.upload

    def swapped(sequence, *rest):
        order = list(range(sequence.count))
        if len(order) > 3:
            order[2], order[3] = order[3], order[2]
        return send(replace(sequence, masks=sequence.masks[order]), *rest)

    modulator.upload = swapped


SPOILED: dict[str, tuple[Callable, tuple[str, ...], Reason, dict, Callable | None]] = {
    "lens cap on, flat field": (masks_bench, ("dark-flat",), Reason.NO_LIGHT, {"always": "dark"}, None),
    "lens cap on, board": (board_bench, ("camera",), Reason.NO_LIGHT, {"always": "dark"}, None),
    "saturated flat": (masks_bench, ("dark-flat",), Reason.SATURATED, {"flat_radiance": 3000.0}, None),
    "lamp flickering": (
        masks_bench,
        ("dark-flat",),
        Reason.LAMP_FLICKERS,
        {"effects": {"illumination_flicker": {"depth": 0.6}}},
        None,
    ),
    "DMD upside down": (masks_bench, ("dark-flat", "registration"), Reason.FLIPPED, {"quarter_turns": 2}, None),
    "masks in the wrong order": (
        masks_bench,
        ("dark-flat", "registration", "masks"),
        Reason.WRONG_ORDER,
        {},
        swap_two_masks,
    ),
    "board out of view": (board_bench, ("camera",), Reason.BOARD_NOT_SEEN, {"always": "flat"}, None),
    "stage slipping": (
        board_bench,
        ("camera", "stage"),
        Reason.STAGE_SLIPS,
        {"mechanics": {"x": {"slip_mm": 0.5}}},
        None,
    ),
    "stage standing still": (
        board_bench,
        ("camera", "stage"),
        Reason.STAGE_STILL,
        {"mechanics": {"x": {"scale": 1e-4}}},
        None,
    ),
}
"""What is wrong -> a bench, the steps up to the one that must refuse, why, its [world], what else is done to it."""


@pytest.fixture(scope="module")
def camera():
    """What the step `camera` finds: the board is held by hand, and what ails a stage is nothing to it."""
    with board_bench() as bench:
        return PROCEDURES["camera"](bench, Bundle())


@pytest.mark.parametrize("what", SPOILED)
def test_a_spoiled_bench_is_refused_with_the_right_reason(what, monkeypatch, camera):
    monkeypatch.setattr(stage, "TARGETS", 4)
    monkeypatch.setattr(stage, "SWEEP_PICTURES", 4)
    make, (*before, last), reason, world, spoil = SPOILED[what]
    with make(**world) as bench:
        known = Bundle()
        for step in before:
            known = known.with_section(camera if step == "camera" else PROCEDURES[step](bench, known))
        if spoil is not None:
            spoil(bench)
        with pytest.raises(CalibrationError) as refused:
            PROCEDURES[last](bench, known)
    assert (refused.value.step, refused.value.reason) == (last, reason)
    assert refused.value.remedy
