"""Sweeps and rests that somebody disturbs, in whole captures; the benchmark `disturbed_sweeps` draws many."""

import numpy as np
import pytest

from gs2ci.core.progress import Silent
from gs2ci.rig.recording import prepare, record
from gs2ci_drivers.failures import PathError
from tests.benchmarks.disturbed_sweeps import KINDS, Draws

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("stage", ["zaber", "grbl"])
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_disturbed_sweep_is_found_or_measured(stage, kind):
    draws = Draws(stage, KINDS[kind], np.random.default_rng(1))
    draws._stated_mm = 0.04
    draws.run()
    assert draws.found["MISSED"] == 0
    assert sum(draws.found.values()) > draws.found["too small to count"]


@pytest.mark.parametrize("stage", ["zaber", "grbl"])
def test_an_undisturbed_sweep_raises_no_alarm(stage):
    draws = Draws(stage, None, np.random.default_rng(1))
    draws.run()
    assert not [outcome for outcome in draws.found if outcome.startswith("found")]
    assert len(draws.errors_mm) == 20
    assert max(draws.errors_mm) < draws._stated_mm


class When(Silent):
    """Does something in the exposure of the second shot."""

    def __init__(self, small, action):
        super().__init__()
        self.small, self.action, self.where = small, action, ""

    def stage(self, name, total=None):
        self.where = name

    def step(self, done, **figures):
        if (self.where, done) == ("shots", 1):
            self.small.bench.world.clock.after(0.15, self.action)


@pytest.mark.parametrize("retries", [0, 1])
def test_an_axis_that_was_to_rest_and_is_moved_by_others_is_found(make_small, tmp_path, retries):
    small = make_small(
        stage={"kind": "grbl", "axes": ["x", "y"]}, capture={"axis": "", "mask_s": 0.2, "shots": 2, "retries": retries}
    )
    when = When(small, lambda: small.bench.stage.run_program("$J=G53Y-99F1800"))
    devices = small.rig.open()
    try:
        if retries:
            record(small.rig, devices, prepare(small.rig, devices), tmp_path / "shot.h5", replace=True, progress=when)
        else:
            with pytest.raises(PathError, match=r"axis y was at rest and moved by 1 mm.*another program"):
                record(
                    small.rig, devices, prepare(small.rig, devices), tmp_path / "shot.h5", replace=True, progress=when
                )
    finally:
        devices.close()


def test_a_stall_from_which_it_recovered_is_told_of_though_the_stage_arrives(make_small, tmp_path):
    small = make_small(capture={"mask_s": 0.04, "shots": 2})
    small.bench.faults["stage"].inject("zaber.recovers", skip=2, value=1e-4)  # too short to be seen by its positions
    with pytest.raises(PathError, match=r"reported WS \(stalled and recovered\)"):
        small.capture()


def test_a_sweep_that_begins_too_late_for_its_masks_is_told_of(make_small):
    small = make_small(capture={"mask_s": 0.04, "shots": 2})
    small.bench.faults["stage"].inject("stage.late", skip=2, value=0.1)
    with pytest.raises(PathError, match=r"ms after its plan: for .* ms of the exposure its speed was not constant"):
        small.capture()


def test_a_sweep_slower_than_the_stage_can_step_is_refused_before_anything_moves(make_small):
    small = make_small(stage={"kind": "grbl"}, capture={"mask_s": 1.0, "from_mm": -60.0, "to_mm": -59.9})
    devices = small.rig.open()
    try:
        plan = prepare(small.rig, devices).plan
    finally:
        devices.close()
    (figure,) = plan.broken
    assert "which is slower than it can step" in figure.value
    assert figure.limit.startswith("0.09537 to")
    assert figure.remedy.startswith("lower `mask_s`, lengthen the travel")
