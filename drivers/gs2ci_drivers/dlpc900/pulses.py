"""What a counted number of pulses on TRIG_OUT_2 says about a DLPC900's firmware. Pure.

Public sources contradict each other on two points, and only a test on the device can decide:

    count of 0x1A31       DLPU018J: patterns to show, entries times repeats    DLPU018F: repeats
    byte 9 bit 0, 0x1A34  DLPU018, table 2-137: 1 disables the pulse           TI's own GUI (API.c): 1 enables it

Here: which interpretations explain a count. Not here: counting (`gs2ci.rig.trigger_check`), the settings (`options`).
"""

from collections.abc import Sequence
from itertools import product

from gs2ci_drivers.dlpc900.firmware import PROFILES, CountUnit
from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.modulator import PulseVerdict

BITS = ("disables", "enables")


def interpret_pulses(options: Dlpc900Options, fires: Sequence[bool], repeats: int, counted: int) -> PulseVerdict:
    """Return which interpretations of the settings by the firmware explain a number of pulses.

    Args:
        options: The options in force; `trigger_out_2_bit` left open was sent as "disables".
        fires: For each entry whether it was meant to pulse.
        repeats: How often the entries were meant to be shown.
        counted: Pulses that were seen.
    """
    configured_unit, configured_bit = PROFILES[options.firmware].count_unit, options.trigger_out_2_bit or BITS[0]
    expected = sum(fires) * repeats
    explaining = [
        (unit, bit)
        for unit, bit in product(CountUnit, BITS)
        if counted == _pulses(options, fires, repeats, unit, inverted=bit != configured_bit)
    ]
    if len(explaining) != 1:
        agrees = (configured_unit, configured_bit) in explaining and bool(options.trigger_out_2_bit)
        sentence = f"{counted} pulses were seen and {expected} expected"
        return PulseVerdict(agrees, sentence, "" if agrees else "check the trigger cable and the sensor's trigger")
    unit, bit = explaining[0]
    found = {"firmware": next(name for name, one in PROFILES.items() if one.count_unit is unit)}
    if unit is configured_unit:
        found = {}
    if bit != options.trigger_out_2_bit:
        found["trigger_out_2_bit"] = bit
    said = (
        f"{counted} pulses were seen, which says that the bit {bit} a pulse and that the firmware counts {unit.value}"
    )
    lines = " and ".join(f'{key} = "{value}"' for key, value in found.items())
    remedy = f"set {lines} in [modulator]" if found else ""
    return PulseVerdict(not found, said, remedy, found, inverted=bit != configured_bit)


def _pulses(options: Dlpc900Options, fires: Sequence[bool], repeats: int, unit: CountUnit, *, inverted: bool) -> int:
    """Return how many pulses a controller sends that interprets count and bit in a given way."""
    count = PROFILES[options.firmware].count(len(fires), repeats)
    shown = count if unit is CountUnit.PATTERNS else count * len(fires)
    return sum(fires[i % len(fires)] != inverted for i in range(shown))
