"""From a pattern sequence to what the DLPC900 is told: sequence entries, trigger settings, image blocks. Pure.

Here: the translation and its settings. Not here: sending (`driver`), the encodings (`lut`, `images`). Imported by
the driver, `gs2ci.rig.opening` and tests.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gs2ci.core.arrays import U8
from gs2ci_drivers.dlpc900 import firmware, timing
from gs2ci_drivers.dlpc900.images import Compression, encode_block, pack_planes, place_of, split_halves
from gs2ci_drivers.dlpc900.lut import ALL_LEDS, LutEntry
from gs2ci_drivers.dlpc900.payloads import MIN_PULSE_US, TriggerOut
from gs2ci_drivers.pattern_sequence import PatternSequence
from gs2ci_drivers.pattern_sequence import TriggerOut as Trigger

_US = 1e6


@dataclass(frozen=True)
class Dlpc900Settings:
    """What the rig file may set for a DLPC900.

    Args:
        firmware: Profile of the firmware revision (`firmware.PROFILES`).
        compression: How images are coded.
        trigger_out_1: Edges of TRIG_OUT_1, relative to begin and end of each pattern: the gate.
        trigger_out_2: Edges of TRIG_OUT_2, both relative to the begin of a pattern: the pulse.
        blocks: First and last block of mirrors to load (DLP6500, 1-bit masks), None for all. Fewer blocks
            switch faster; masks must be dark outside them.
        leds: LED enables during a pattern: bit 0 red, 1 green, 2 blue.
        invert: Whether the device inverts all patterns.
        reply_timeout_s: How long an answer may take.
        wake_s: How long leaving standby or idle takes.
    """

    firmware: str = firmware.DEFAULT_PROFILE
    compression: Compression = Compression.ERLE
    trigger_out_1: TriggerOut = field(default_factory=TriggerOut)
    trigger_out_2: TriggerOut = field(default_factory=lambda: TriggerOut(fall_us=MIN_PULSE_US))
    blocks: tuple[int, int] | None = None
    leds: int = ALL_LEDS
    invert: bool = False
    reply_timeout_s: float = 10.0
    wake_s: float = 3.0


def lut_entries(sequence: PatternSequence, leds: int = ALL_LEDS) -> list[LutEntry]:
    """Translate one pass of a sequence into its entries; the pause is the dark time of the last one."""
    last = sequence.count - 1
    entries = []
    for i in range(sequence.count):
        image_index, bit_position = place_of(i, sequence.bit_depth)
        entries.append(
            LutEntry(
                index=i,
                exposure_us=round(sequence.exposure_s * _US),
                dark_us=round((sequence.pause_s if i == last else sequence.dark_s) * _US),
                depth_bits=sequence.bit_depth,
                image_index=image_index,
                bit_position=bit_position,
                leds=leds,
                trigger_out_2=sequence.trigger is Trigger.PER_MASK
                or (sequence.trigger is Trigger.PER_EXPOSURE and i == 0),
            )
        )
    return entries


@dataclass(frozen=True)
class ImageSet:
    """The encoded images of a sequence.

    Args:
        digest: Same masks, same depth, same digest.
        primary: One block per image for the primary controller.
        secondary: The right halves for the secondary controller; empty where there is none.
    """

    digest: bytes
    primary: tuple[bytes, ...]
    secondary: tuple[bytes, ...] = ()

    @property
    def total_bytes(self) -> int:
        """Get the bytes of all blocks."""
        return sum(map(len, self.primary + self.secondary))

    def in_order(self) -> Iterator[tuple[int, bool, bytes]]:
        """Yield (image index, whether for the secondary controller, block) in the order that the device wants."""
        for index in reversed(range(len(self.primary))):
            if self.secondary:
                yield index, True, self.secondary[index]
            yield index, False, self.primary[index]

    @property
    def upload_s(self) -> float:
        """Get the least time they take over full-speed USB, seconds."""
        return sum(map(timing.upload_s, map(len, self.primary + self.secondary)))


def digest_masks(sequence: PatternSequence) -> bytes:
    """Return a fingerprint of masks and depth, which decide the image data; times and triggers do not."""
    head = f"{sequence.masks.shape} {sequence.masks.dtype} {sequence.bit_depth}".encode()
    return hashlib.blake2b(np.ascontiguousarray(sequence.masks).data, digest_size=16, key=head[:64]).digest()


def encode_images(sequence: PatternSequence, settings: Dlpc900Settings, *, dual: bool) -> ImageSet:
    """Pack and encode the masks of a sequence.

    Args:
        sequence: With [N, H, W] uint8 or uint16 levels of at most 8 bits.
        settings: Compression and firmware profile.
        dual: Whether two controllers drive half the columns each.
    """
    levels: U8 = sequence.masks.astype(np.uint8, copy=False)
    pixel_format = firmware.profile(settings.firmware).pixel_format
    primary, secondary = [], []
    for words in pack_planes(levels, sequence.bit_depth):
        left, right = split_halves(words) if dual else (words, None)
        primary.append(encode_block(left, settings.compression, pixel_format))
        if right is not None:
            secondary.append(encode_block(right, settings.compression, pixel_format))
    return ImageSet(digest_masks(sequence), tuple(primary), tuple(secondary))
