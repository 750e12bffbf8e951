import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.config import CaptureTable, rig_from_tables
from gs2ci.rig.design.candidates import Asked, CaptureCandidate, NotTried, Possible, Varied
from tests.small_benches import TABLES


@pytest.fixture
def bench(tmp_path):
    """Return a bench with another [capture], and without some tables."""

    def made(*without, **capture):
        tables = {key: table for key, table in TABLES.items() if key not in without}
        return rig_from_tables({**tables, "capture": {**TABLES["capture"], **capture}}, tmp_path / "rig.toml")

    return made


def test_candidates_are_each_with_each_of_what_is_varied(bench):
    found = Varied(masks=(4, 8), open_shares=(0.25,), elements=(1,), travels_mm=(1, 2), exposures=(1,)).candidates(
        bench()
    )
    assert found == [CaptureCandidate(n, 0.25, 1, mm, 1) for n in (4, 8) for mm in (1.0, 2.0)]


def test_without_values_those_about_the_rig_files_own_are_tried(bench):
    found = Varied().candidates(bench())
    assert {one.masks for one in found} == {2, 4, 8}
    assert {one.travel_mm for one in found} == {1.0, 2.0, 4.0}
    assert {one.exposures for one in found} == {1, 2, 4}
    assert len(found) == 3 * 3 * 2 * 3 * 3


def test_a_camera_at_rest_has_candidates_without_travel(bench):
    assert {one.travel_mm for one in Varied().candidates(bench(axis=""))} == {0.0}


@pytest.mark.parametrize(
    ("varied", "problem"),
    [
        (Varied(masks=(0,)), "--masks 0"),
        (Varied(open_shares=(1.5,)), "--open-share 1.5"),
        (Varied(elements=(65,)), "--element 65"),
        (Varied(travels_mm=(-1.0,)), "--travel-mm -1"),
        (Varied(travels_mm=(float("nan"),)), "--travel-mm nan"),
        (Varied(exposures=(100,)), "--exposures 100"),
        (Varied(masks=tuple(range(1, 100))), "5346 candidates"),
    ],
)
def test_values_that_no_capture_has_are_refused(bench, varied, problem):
    with pytest.raises(InputError, match=problem):
        varied.candidates(bench())


@pytest.mark.parametrize(
    ("capture", "problem"),
    [
        ({"pattern_file": "masks.npy"}, "pattern_file = 'masks.npy'"),
        ({"mode": "per-mask"}, "mode = 'per-mask'"),
        ({"continuous": True}, "continuous = true"),
    ],
)
def test_captures_whose_masks_cannot_be_varied_are_refused(bench, capture, problem):
    with pytest.raises(InputError, match=problem):
        Varied().candidates(bench(**capture))


def test_a_travel_without_an_axis_is_refused(bench):
    with pytest.raises(InputError, match=r"a travel of 3 mm on a bench whose .capture. names no axis"):
        Varied(travels_mm=(3.0,)).candidates(bench(axis=""))


def test_an_exposure_takes_as_long_as_the_rig_files_own_whatever_the_number_of_masks():
    own = CaptureTable(masks=8, mask_s=0.02, dark_s=0.001, axis="x", from_mm=5.0, to_mm=3.0, shots=6, burst=3)
    made = CaptureCandidate(16, 0.5, 2, 4.0, 2).capture(own)
    assert made.masks * (made.mask_s + made.dark_s) == pytest.approx(8 * 0.021)
    assert (made.density, made.element, made.shots, made.burst) == (0.5, 2, 1, 1)
    assert (made.from_mm, made.to_mm) == (6.0, 2.0)  # about the same middle, in the same direction


def test_masks_that_dark_times_leave_no_time_for_are_refused():
    own = CaptureTable(masks=2, mask_s=0.001, dark_s=0.01)
    with pytest.raises(InputError, match=r"8 masks in the rig file's exposure with dark_s = 0.01"):
        CaptureCandidate(8, 0.5, 1, 0.0, 1).capture(own)


def test_what_the_devices_can_take_is_told_from_what_they_cannot_with_the_reason(bench):
    few, far = CaptureCandidate(4, 0.25, 1, 2.0, 2), CaptureCandidate(4, 0.25, 1, 5000.0, 1)
    many, coarse = CaptureCandidate(1000, 0.25, 1, 2.0, 1), CaptureCandidate(4, 0.25, 64, 2.0, 1)
    found = list(Asked(bench()).of([few, many, far, coarse]))
    assert isinstance(found[0], Possible)
    assert found[0].capture.mask_s == pytest.approx(0.02)
    assert found[0].capture_s > 2 * 4 * 0.02
    assert isinstance(found[1], NotTried)
    assert found[1].reason == "1000 masks, of which the modulator holds 400"
    assert isinstance(found[2], NotTried)
    assert "travel" in found[2].reason
    assert found[3] == NotTried(coarse, "elements of 64 px are larger than the picture")


def test_masks_that_the_modulator_cannot_switch_so_fast_are_left_out(bench):
    (found,) = Asked(bench(mask_s=0.001)).of([CaptureCandidate(100, 0.25, 1, 2.0, 1)])
    assert isinstance(found, NotTried)
    assert "time per mask: 40 us, allowed: " in found.reason


def test_masks_through_which_white_fills_the_wells_are_left_out(tmp_path):
    tables = {**TABLES, "optics": {"full_scale_e_per_s": 2e5}, "sensor": {**TABLES["sensor"], "full_well_e": 10000.0}}
    asked = Asked(rig_from_tables(tables, tmp_path / "rig.toml"))
    dark, bright = asked.of([CaptureCandidate(8, share, 1, 2.0, 1) for share in (0.125, 0.9)])
    assert isinstance(dark, Possible)
    assert isinstance(bright, NotTried)
    assert "bright pixels of a white scene" in bright.reason


def test_a_capture_that_takes_too_long_is_left_out(bench):
    one, four = CaptureCandidate(4, 0.25, 1, 2.0, 1), CaptureCandidate(4, 0.25, 1, 2.0, 4)
    (first,) = Asked(bench()).of([one])
    found = list(Asked(bench(), longest_s=2 * first.capture_s).of([one, four]))
    assert isinstance(found[0], Possible)
    assert found[1].reason.startswith("more than")


def test_a_camera_at_rest_is_asked_without_its_stage(bench):
    (found,) = Asked(bench()).of([CaptureCandidate(4, 0.5, 2, 0.0, 1)])
    assert isinstance(found, Possible)
    assert found.capture.from_mm == found.capture.to_mm
    assert (found.capture.density, found.capture.element) == (0.5, 2)


def test_a_candidate_says_what_it_is():
    assert str(CaptureCandidate(8, 0.25, 2, 1.5, 1)) == "1 exposure of 8 masks, 0.25 open, elements of 2 px, 1.5 mm"


def test_a_real_bench_is_asked_by_the_twins_of_its_devices(tmp_path):
    real = {**TABLES, "modulator": {**TABLES["modulator"], "port": "/dev/hidraw0"}}
    real["sensor"] = {**TABLES["sensor"], "port": "/dev/video0"}
    real["stage"] = {**TABLES["stage"], "port": "/dev/ttyUSB0"}
    del real["world"]
    table = rig_from_tables(real, tmp_path / "rig.toml")
    (found,) = Asked(table).of([CaptureCandidate(4, 0.25, 1, 2.0, 1)])
    assert isinstance(found, Possible)
    del real["sensor"]["width"]
    with pytest.raises(InputError, match="the size of the picture of 'rig' is not known"):
        Asked(rig_from_tables(real, tmp_path / "rig.toml"))
