"""From masks with their times to what an ALP device shows: pictures of one common time, and the pulses they have.

All pictures of a sequence take the same time. Without dark time they follow each other in "binary uninterrupted" mode,
where the last one stays on the mirrors until something else is shown: there a run ends with a dark picture. Pauses are
dark pictures. Pulses come by a gate that repeats after at most 16 pictures.

Here: `lay_out`. Pure. Not here: sending it (`driver`).
"""

from dataclasses import dataclass

from gs2ci_drivers.alp.codes import MOST_GATED
from gs2ci_drivers.failures import OutOfRangeError
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut

_US = 1e-6


@dataclass(frozen=True)
class AlpPictures:
    """A sequence in the device's terms.

    Args:
        order: Index of the mask of each picture; -1 for a dark one.
        repeats: How often the pictures are shown; 0 until they are halted.
        picture_us: Time from one picture to the next.
        illuminate_us: How long each is shown; as long as `picture_us` in uninterrupted mode.
        pulses: Which pictures have a pulse; repeated.
    """

    order: tuple[int, ...]
    repeats: int
    picture_us: int
    illuminate_us: int
    pulses: tuple[bool, ...]

    @property
    def uninterrupted(self) -> bool:
        """Get whether pictures follow each other without dark time."""
        return self.picture_us == self.illuminate_us


def lay_out(device: str, sequence: PatternSequence) -> AlpPictures:
    """Lay a sequence out.

    Raises:
        OutOfRangeError: A pause between passes that is not made of whole pictures, or a pattern of pulses that does not
            repeat after 16 pictures.
    """
    count, repeats = sequence.count, sequence.repeats
    exposure_us, dark_us = round(sequence.exposure_s / _US), round(sequence.dark_s / _US)
    picture_us = exposure_us + dark_us
    extra = 0 if repeats == 1 else _dark_pictures(device, sequence, picture_us, dark_us)
    order = [*range(count), *[-1] * extra]
    if dark_us == 0 and extra == 0 and repeats > 0:
        order, repeats = [*order * repeats, -1], 1
    pulses = _pulses(sequence.trigger, order)
    if len(pulses) > MOST_GATED:
        raise OutOfRangeError(
            device,
            f"pulses that repeat after {len(pulses)} pictures",
            asked=f"{count} masks, {sequence.trigger.value}, {sequence.repeats} passes",
            allowed=f"at most {MOST_GATED} pictures, dark ones included",
            remedy="use fewer masks or a smaller `burst`, or give masks a `dark_s`",
        )
    return AlpPictures(tuple(order), repeats, picture_us, exposure_us, pulses)


def _dark_pictures(device: str, sequence: PatternSequence, picture_us: int, dark_us: int) -> int:
    """Return how many dark pictures make the pause after a pass."""
    rest_us = round(sequence.pause_s / _US) - dark_us
    extra, left_us = divmod(rest_us, picture_us)
    if extra < 0 or left_us:
        nearest_us = dark_us + max(extra + (1 if left_us else 0), 0) * picture_us
        raise OutOfRangeError(
            device,
            f"a pause of {sequence.pause_s / _US:.0f} us between passes",
            asked="upload",
            allowed=f"the dark time and whole pictures of {picture_us} us: {nearest_us} us is the next",
        )
    return extra


def _pulses(trigger: TriggerOut, order: list[int]) -> tuple[bool, ...]:
    """Return which pictures have a pulse, as the shortest pattern that repeats."""
    if trigger is TriggerOut.NONE:
        return (False,)
    wanted = [index == 0 if trigger is TriggerOut.PER_EXPOSURE else index >= 0 for index in order]
    return (True,) if all(wanted) else tuple(wanted)
