"""Counting pulses tells how a controller reads the count of 0x1A31 and bit 0 of an entry's byte 9."""

from itertools import product

import pytest

from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.dlpc900.pulses import interpret_pulses

FIRST = [True, False, False, False]
PASSES = 3
READINGS = [(firmware, bit) for firmware in ("rev-j", "rev-f") for bit in ("disables", "enables")]


def seen(told: tuple[str, str], truth: tuple[str, str]) -> int:
    """Count by hand what a controller of one reading sends when it was told by another."""
    count = {"rev-j": 12, "rev-f": 3}[told[0]]
    shown = {"rev-j": count, "rev-f": 4 * count}[truth[0]]
    pulses = [first is (told[1] == truth[1]) for first in FIRST]
    return sum(pulses[i % 4] for i in range(shown))


@pytest.mark.parametrize(("told", "truth"), list(product(READINGS, READINGS)))
def test_every_reading_is_recognised_under_every_other(told: tuple[str, str], truth: tuple[str, str]) -> None:
    verdict = interpret_pulses(
        Dlpc900Options(firmware=told[0], trigger_out_2_bit=told[1]), FIRST, PASSES, seen(told, truth)
    )
    assert verdict.agrees is (told == truth)
    wanted = {"firmware": truth[0]} if told[0] != truth[0] else {}
    assert verdict.settings == wanted | ({"trigger_out_2_bit": truth[1]} if told[1] != truth[1] else {})
    assert verdict.inverted is (told[1] != truth[1])
    assert all(f'{key} = "{value}"' in verdict.remedy for key, value in verdict.settings.items())


@pytest.mark.parametrize("truth", ["disables", "enables"])
def test_a_polarity_that_is_not_stated_is_found_and_never_agrees(truth: str) -> None:
    verdict = interpret_pulses(Dlpc900Options(), FIRST, PASSES, seen(("rev-j", "disables"), ("rev-j", truth)))
    assert not verdict.agrees
    assert verdict.settings == {"trigger_out_2_bit": truth}


@pytest.mark.parametrize("counted", [0, 4, 13])
def test_a_number_that_no_reading_explains_points_to_the_cable(counted: int) -> None:
    verdict = interpret_pulses(Dlpc900Options(trigger_out_2_bit="disables"), FIRST, PASSES, counted)
    assert not verdict.agrees
    assert not verdict.settings
    assert "cable" in verdict.remedy


def test_a_right_number_agrees_where_several_readings_would_give_it() -> None:
    assert interpret_pulses(Dlpc900Options(trigger_out_2_bit="disables"), [True], 1, 1).agrees
