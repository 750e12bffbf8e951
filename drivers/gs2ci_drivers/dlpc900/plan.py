"""From a pattern sequence to the data for the DLPC900: sequence entries, trigger settings, image blocks. Pure.

Here: the translation. Not here: settings (`options`), sending (`driver`), the encodings (`lut`, `images`).
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import U8
from gs2ci_drivers.dlpc900 import firmware, timing
from gs2ci_drivers.dlpc900.images import encode_block, pack_planes, place_of, split_halves
from gs2ci_drivers.dlpc900.lut import ALL_LEDS, LutEntry
from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut

_US = 1e6


def lut_entries(sequence: PatternSequence, leds: int = ALL_LEDS) -> list[LutEntry]:
    """Translate one pass of a sequence into its entries; the pause is the dark time of the last one."""
    last = sequence.count - 1
    entries = []
    for i, mask in enumerate(sequence.order):
        image_index, bit_position = place_of(mask, sequence.bit_depth)
        entries.append(
            LutEntry(
                index=i,
                exposure_us=round(sequence.exposure_s * _US),
                dark_us=round((sequence.pause_s if i == last else sequence.dark_s) * _US),
                depth_bits=sequence.bit_depth,
                image_index=image_index,
                bit_position=bit_position,
                leds=leds,
                trigger_out_2=sequence.trigger is TriggerOut.PER_MASK
                or (sequence.trigger is TriggerOut.PER_EXPOSURE and i == 0),
            )
        )
    return entries


@dataclass(frozen=True)
class ImageSet:
    """The encoded images of a sequence.

    Args:
        digest: Fingerprint of masks and depth.
        primary: One block per image for the primary controller.
        secondary: The right halves for the secondary controller; empty if there is none.
    """

    digest: bytes
    primary: tuple[bytes, ...]
    secondary: tuple[bytes, ...] = ()

    @property
    def total_bytes(self) -> int:
        """Get the bytes of all blocks."""
        return sum(map(len, self.primary + self.secondary))

    def in_order(self) -> Iterator[tuple[int, bool, bytes]]:
        """Yield (image index, whether for the secondary controller, block) in the order that the device requires."""
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
    masks = sequence.masks
    head = f"{masks.shape} {masks.dtype} {sequence.bit_depth}".encode()
    # Eight pixels of masks that are open or closed are one byte: hashing takes longer than packing.
    told = np.packbits(masks) if masks.dtype == np.uint8 and masks.max(initial=0) <= 1 else np.ascontiguousarray(masks)
    return hashlib.blake2b(told.data, digest_size=16, key=head[:64]).digest()


def encode_images(
    sequence: PatternSequence, settings: Dlpc900Options, *, dual: bool, digest: bytes | None = None
) -> ImageSet:
    """Pack and encode the masks of a sequence.

    Args:
        sequence: With [N, H, W] uint8 or uint16 levels of at most 8 bits.
        settings: With the firmware profile.
        dual: Whether two controllers drive half the columns each.
        digest: What `digest_masks` says of the sequence, where it has been asked already: it takes as long as packing.
    """
    levels: U8 = sequence.masks.astype(np.uint8, copy=False)
    pixel_format = firmware.PROFILES[settings.firmware].pixel_format
    primary, secondary = [], []
    for words in pack_planes(levels, sequence.bit_depth):
        left, right = split_halves(words) if dual else (words, None)
        primary.append(encode_block(left, pixel_format))
        if right is not None:
            secondary.append(encode_block(right, pixel_format))
    return ImageSet(digest or digest_masks(sequence), tuple(primary), tuple(secondary))
