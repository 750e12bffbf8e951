"""A bundle held against coded shots: moved where they surely say so, kept beside, refused where they cannot tell."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot
from gs2ci.rig import updating
from gs2ci.rig.updating import how_far_moved, update_bundle
from gs2ci_calibration.bundle import Bundle, read_bundle, write_bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.refusals import CalibrationError, Reason
from tests.reconstruct.registration.warps import warped

SIZE, COUNT = (96, 112), 6


@pytest.fixture(scope="module")
def masks():
    return (np.random.default_rng(5).random((COUNT, *SIZE)) < 0.33).astype(np.float32)


@pytest.fixture
def path(tmp_path, masks):
    section = Section(
        "masks",
        {"masks": Estimate(masks, np.float32(0.001), "1"), "contrast": Estimate(0.01, 0.001, "1")},
        arrays={"valid": np.ones(SIZE, np.uint8)},
    )
    write_bundle(tmp_path / "bench.cal.h5", Bundle(sections={"masks": section}))
    return tmp_path / "bench.cal.h5"


def shot_through(were, believed, seed=0, *, light=1.0):
    rng = np.random.default_rng([seed, 1])
    wide = gaussian_filter(rng.random((SIZE[0], SIZE[1] + COUNT)), 2.0)
    wide = 0.1 + 0.8 * (wide - wide.min()) / np.ptp(wide)
    views = np.stack([wide[:, k : k + SIZE[1]] for k in range(COUNT)])
    reading = light * (were * views).sum(axis=0) + rng.normal(0, 0.01, SIZE)
    return Path(f"shot{seed}.h5"), Shot(reading.astype(np.float32)[..., None], believed).check()


def test_masks_are_moved_to_where_the_shots_show_them_and_the_old_bundle_is_kept(path, masks):
    before, were = path.read_bytes(), warped(masks, down_px=0.4, right_px=-0.3)
    found = update_bundle(path, [shot_through(were, masks, seed) for seed in range(2)])
    assert found.taken == ("down_px", "right_px")
    assert found.parameters["down_px"].agrees(0.4, 4)
    assert float(found.parameters["down_px"]) == pytest.approx(0.4, abs=0.02)
    assert found.largest_px == pytest.approx(0.5, abs=0.03)
    assert found.kept.read_bytes() == before
    section = read_bundle(path).sections["masks"]
    inner = np.s_[:, 4:-4, 4:-4]
    assert np.abs(section.array("masks")[inner] - were[inner]).mean() < 0.01
    assert section.estimates["masks"].error > 0.001
    assert any("coded shots" in note for note in section.notes)
    assert float(section.number("contrast")) == pytest.approx(0.01)


def test_several_shots_tell_more_than_one(masks):
    were = warped(masks, right_px=0.5)
    told = [updating.values_of(updating._registered(shot_through(were, masks, seed)[1])) for seed in range(4)]
    one, four = (
        updating._weighted_mean("right_px", [values["right_px"] for values in told[:count]]) for count in (1, 4)
    )
    assert four.error < 0.75 * one.error


def test_what_lies_beyond_the_masks_that_were_known_is_no_longer_valid(path, masks):
    update_bundle(path, [shot_through(np.roll(masks, 3, axis=2), masks)])
    valid = read_bundle(path).sections["masks"].arrays["valid"]
    assert not valid[:, :2].any()
    assert valid[4:-4, 5:-4].all()


def test_right_masks_change_nothing(path, masks):
    before = path.read_bytes()
    found = update_bundle(path, [shot_through(masks, masks, seed) for seed in range(2)])
    assert (found.taken, found.kept, found.largest_px) == ((), None, 0.0)
    assert abs(float(found.parameters["right_px"])) < 0.02
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.glob("*.h5")] == [path.name]


def test_soft_masks_as_a_bench_measures_them_are_moved_and_not_sharpened(path, masks):
    """A blur that no held-out pixel confirmed was taken as sure: the update made the masks worse than they were."""
    soft = gaussian_filter(masks, (0, 0.5, 0.5)).astype(np.float32)
    section = read_bundle(path).sections["masks"]
    measured = replace(section, estimates={**section.estimates, "masks": Estimate(soft, np.float32(0.001), "1")})
    write_bundle(path, Bundle(sections={"masks": measured}))
    were = warped(soft, right_px=0.21, down_px=-0.13)
    found = update_bundle(path, [shot_through(were, soft, seed) for seed in range(2)])
    assert found.taken == ("down_px", "right_px")
    inner = np.s_[:, 4:-4, 4:-4]
    corrected = read_bundle(path).sections["masks"].array("masks")
    assert np.abs(corrected[inner] - were[inner]).mean() < 0.2 * np.abs(soft[inner] - were[inner]).mean()


def test_a_shot_that_cannot_tell_is_named_and_left_out(path, masks):
    dark = shot_through(masks, masks, 7, light=0.0)
    found = update_bundle(path, [dark, shot_through(warped(masks, right_px=0.5), masks)])
    assert found.silent == (dark[0],)
    assert found.shots == 1


def refused(path, shots, reason, words):
    before = path.read_bytes()
    with pytest.raises(CalibrationError, match=words) as told:
        update_bundle(path, shots)
    assert told.value.reason is reason
    assert path.read_bytes() == before
    assert len(list(path.parent.glob("*.h5"))) == 1


def test_shots_that_cannot_tell_are_refused(path, masks):
    refused(path, [shot_through(masks, masks, light=0.0)], Reason.NOT_REGISTERED, "cannot be found in any of 1 shots")


def test_shots_of_other_masks_are_refused(path, masks):
    refused(path, [shot_through(masks, masks[::-1].copy())], Reason.DOES_NOT_FIT, "other masks than the bundle's")


def test_masks_that_are_turned_or_in_another_order_are_refused(path, masks):
    refused(path, [shot_through(masks[:, :, ::-1], masks)], Reason.FLIPPED, "mirrored")
    refused(path, [shot_through(np.roll(masks, 2, axis=0), masks)], Reason.WRONG_ORDER, "was shown first")


def test_shots_that_contradict_each_other_are_refused(path, masks):
    shots = [shot_through(warped(masks, right_px=moved), masks, seed) for seed, moved in enumerate((0.2, 0.9))]
    refused(path, shots, Reason.BAD_FIT, "contradict each other: right_px from 0.2")


def test_a_bundle_without_masks_is_refused(tmp_path, masks):
    path = tmp_path / "empty.cal.h5"
    write_bundle(path, Bundle())
    refused(path, [shot_through(masks, masks)], Reason.NEEDS, "no section 'masks'")


def test_an_older_copy_is_never_replaced(path):
    copies = set()
    for _ in range(2):
        copies.add(updating._keep(path))
    assert len(copies) == 2
    assert all(one.is_file() for one in copies)


def test_how_far_masks_moved_is_said_with_what_the_bundle_promises(path, masks):
    bundle = read_bundle(path)
    near = how_far_moved(shot_through(masks, masks)[1], bundle)
    assert not near.too_far
    assert near.error_px < 0.02
    far = how_far_moved(shot_through(warped(masks, right_px=0.5), masks)[1], bundle)
    assert far.too_far
    assert far.largest_px == pytest.approx(0.5, abs=0.03)
    affine = Estimate(np.eye(2, 3), np.full((2, 3), 0.2), "px")
    loose = bundle.with_section(Section("registration", {"sensor_from_modulator": affine}))
    assert not how_far_moved(shot_through(warped(masks, right_px=0.5), masks)[1], loose).too_far
    assert how_far_moved(shot_through(masks, masks, light=0.0)[1], bundle) is None
    assert not far.otherwise


def test_masks_that_are_turned_or_in_another_order_are_not_said_to_be_where_the_bundle_has_them(path, masks):
    """Their displacement is that of the turned ones, and small."""
    bundle = read_bundle(path)
    turned = how_far_moved(shot_through(masks[:, ::-1, ::-1], masks)[1], bundle)
    assert not turned.too_far
    assert turned.otherwise.startswith("are turned by 180")
    other = how_far_moved(shot_through(np.roll(masks, 2, axis=0), masks)[1], bundle)
    assert other.otherwise.startswith("begin with mask ")
