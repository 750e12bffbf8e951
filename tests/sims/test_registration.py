import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.registration import MaskAlignment

SIZE = (12, 16)


def pattern(seed=0, shape=(80, 100)):
    return (np.random.default_rng(seed).random(shape) < 0.4).astype(np.uint8)


def points_seen(registration, levels):
    """Return what each sensor pixel sees, by sampling its square finely through the map's inverse."""
    affine = registration.sensor_from_modulator(*SIZE)
    inverse = np.linalg.inv(affine[:, :2])
    fine = 24
    steps = (np.arange(fine) + 0.5) / fine
    seen = np.zeros(SIZE)
    for dy in steps:
        for dx in steps:
            y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
            u, v = np.tensordot(inverse, np.stack([x + dx - affine[0, 2], y + dy - affine[1, 2]]), axes=1)
            seen += levels[np.floor(v).astype(int), np.floor(u).astype(int)]
    return seen / fine**2


def test_without_misalignment_a_pixel_sees_the_mean_of_its_block():
    levels = pattern()
    seen = MaskAlignment(2, 10, 20).seen(levels, 1, *SIZE)
    assert seen == pytest.approx(levels[10:34, 20:52].reshape(12, 2, 16, 2).mean(axis=(1, 3)))


@pytest.mark.parametrize(
    "options",
    [
        {"right_px": 0.3, "down_px": -1.7},
        {"magnification": 1.05},
        {"mirrored": True},
        {"quarter_turns": 2},
        {"quarter_turns": 2, "mirrored": True, "right_px": 0.4},
    ],
)
def test_misaligned_pixels_integrate_over_their_squares(options):
    levels = pattern(1)
    registration = MaskAlignment(2, 20, 24, **options)
    assert registration.seen(levels, 1, *SIZE) == pytest.approx(points_seen(registration, levels), abs=0.03)


def test_a_small_turn_is_integrated_to_within_what_is_stated():
    levels = pattern(2)
    registration = MaskAlignment(3, 16, 20, turn_mrad=30.0)
    assert registration.seen(levels, 1, *SIZE) == pytest.approx(points_seen(registration, levels), abs=0.06)


def test_a_mirrored_and_turned_image_lies_as_the_map_says():
    levels = np.zeros((80, 100), np.uint8)
    levels[20:24, 30:34] = 1
    for turns in range(4):
        registration = MaskAlignment(2, 14, 22, mirrored=True, quarter_turns=turns)
        seen = registration.seen(levels, 1, *SIZE)
        centre = registration.sensor_from_modulator(*SIZE) @ np.array([32.0, 22.0, 1.0])
        rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
        found = ((seen * columns).sum() / seen.sum(), (seen * rows).sum() / seen.sum())
        assert found == pytest.approx(tuple(centre), abs=1e-6)


def test_beyond_the_modulator_nothing_is_seen_when_misalignment_leads_there():
    seen = MaskAlignment(1, 0, 0, right_px=4.0).seen(np.ones((40, 40), np.uint8), 1, *SIZE)
    assert (seen[:, :4] == 0).all()
    assert (seen[:, 4:] == 1).all()


def test_a_sensor_that_looks_beyond_the_modulator_nominally_is_refused():
    with pytest.raises(InputError, match="looks beyond"):
        MaskAlignment(2, 70, 0).seen(pattern(), 1, *SIZE)
    with pytest.raises(InputError, match="turn_mrad = 80"):
        MaskAlignment(2, 0, 0, turn_mrad=80.0)
    with pytest.raises(InputError, match="right_px = nan"):
        MaskAlignment(2, 0, 0, right_px=float("nan"))
