"""Entries of the pattern sequence (the 12 bytes of command 0x1A34), to bytes. Pure.

Here: one entry. Not here: which entries a capture needs (`driver`), what the minimum times are (`timing`).
Imported by the driver and tests.

Byte 9 bit 0 controls the pulse on TRIG_OUT_2. DLPU018 (table 2-137) says that 1 disables it, the code of TI's GUI that
1 enables it: the caller of `encode` states which (`Dlpc900Options.trigger_out_2_bit`).
"""

from dataclasses import dataclass
from typing import Final

from gs2ci.core.errors import InputError

MAX_TIME_US: Final = 0xFFFFFF
ALL_LEDS: Final = 7

_CLEAR: Final = 0x01
_TRIGGER_OUT_2: Final = 0x01


@dataclass(frozen=True)
class LutEntry:
    """One step of the sequence: which bits of which image are shown, for how long.

    Args:
        index: Place in the sequence, from 0.
        exposure_us: How long the pattern is shown, µs, below 2²⁴.
        dark_us: How long it is black afterwards, µs, below 2²⁴.
        depth_bits: Grey depth, 1 to 8.
        image_index: Which uploaded image, 0 to 255.
        bit_position: Lowest of its bits in the image's 24-bit word, 0 to 23.
        leds: Which LED enables are on: bit 0 red, 1 green, 2 blue.
        trigger_out_2: Whether TRIG_OUT_2 pulses when the pattern begins.

    Raises:
        InputError: A field does not fit its bits.
    """

    index: int
    exposure_us: int
    dark_us: int = 0
    depth_bits: int = 1
    image_index: int = 0
    bit_position: int = 0
    leds: int = ALL_LEDS
    trigger_out_2: bool = True

    def __post_init__(self) -> None:
        ranges = {
            "index": (0, 0xFFFF),
            "exposure_us": (1, MAX_TIME_US),
            "dark_us": (0, MAX_TIME_US),
            "depth_bits": (1, 8),
            "image_index": (0, 255),
            "bit_position": (0, 24 - self.depth_bits),
            "leds": (0, 7),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"pattern {self.index}: {name} = {value}", allowed=f"{low} to {high}")

    def encode(self, *, bit_enables: bool = False) -> bytes:
        """Return the entry's 12 bytes.

        Args:
            bit_enables: Whether bit 0 of byte 9 enables the pulse instead of disabling it.
        """
        flags = (self.depth_bits - 1) << 1 | self.leds << 4
        # The clear bit is defined for 1-bit patterns only; deeper ones are cleared by the controller itself.
        flags |= _CLEAR if self.depth_bits == 1 else 0
        options = _TRIGGER_OUT_2 if self.trigger_out_2 is bit_enables else 0
        return (
            self.index.to_bytes(2, "little")
            + self.exposure_us.to_bytes(3, "little")
            + bytes([flags])
            + self.dark_us.to_bytes(3, "little")
            + bytes([options])
            + (self.image_index | self.bit_position << 11).to_bytes(2, "little")
        )
