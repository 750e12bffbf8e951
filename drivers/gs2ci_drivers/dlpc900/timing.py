"""What each mirror device can do: size, minimum times, capacity, and how long an upload takes. Pure.

Here: numbers of DLPU018 (tables 2-82 ff.) and of the USB link. Not here: the sequence itself (`lut`), the driver.
Imported by the driver and tests.
"""

import enum
from dataclasses import dataclass
from typing import Final

from gs2ci_drivers.dlpc900.packets import REPORT_BYTES
from gs2ci_drivers.dlpc900.payloads import CHUNK_BYTES, MAX_IMAGES

# Full speed USB polls an interrupt endpoint once per 1 ms frame: one report each, 64 kB/s at best.
REPORT_PERIOD_S: Final = 1e-3
_CHUNK_OVERHEAD_BYTES: Final = 8  # header, command, byte count


class DmdType(enum.IntEnum):
    """Mirror devices by the type number of 0x0206."""

    DLP6500 = 1
    DLP9000 = 2
    DLP670S = 3
    DLP500YX = 4
    DLP5500 = 5


@dataclass(frozen=True)
class DmdModel:
    """One mirror device.

    Args:
        name: TI's part name.
        width: Mirrors per row.
        height: Rows.
        pitch_um: Distance of mirror centres, µm.
        min_exposure_us: Shortest time on show for 1, 2, ... 8 bits, µs; None where TI gives no table.
        one_bit_capacity: 1-bit patterns that fit on board.
        max_entries: Sequence entries in pattern-on-the-fly mode.
        block_us: Shortest time on show of a 1-bit pattern with 1, 2, ... active mirror blocks, µs (DLPU018, table
            2-102); empty where TI gives none.
        dual: Whether two controllers drive half the columns each (TI publishes firmware for a primary and a secondary).
    """

    name: str
    width: int
    height: int
    pitch_um: float
    min_exposure_us: tuple[int, ...] | None
    one_bit_capacity: int
    max_entries: int
    block_us: tuple[int, ...] = ()
    dual: bool = False

    @property
    def blocks(self) -> int:
        """Get the number of mirror blocks, 0 where no times are given."""
        return len(self.block_us)


MODELS: Final[dict[DmdType, DmdModel]] = {
    DmdType.DLP6500: DmdModel(
        "DLP6500", 1920, 1080, 7.56, (105, 304, 394, 823, 1215, 1487, 1998, 4046), 400, 400,
        (24, 45, 45, 45, 48, 54, 60, 66, 72, 78, 84, 90, 96, 101, 105),
    ),
    DmdType.DLP9000: DmdModel(
        "DLP9000", 2560, 1600, 7.56, (105, 304, 380, 733, 1215, 1487, 1998, 4046), 480, 400,
        (24, 42, 42, 42, 45, 51, 56, 61, 67, 72, 77, 83, 88, 93, 99, 105), dual=True,
    ),
    DmdType.DLP670S: DmdModel(
        "DLP670S", 2716, 1600, 5.4, (100, 343, 438, 768, 1299, 1488, 2000, 4046), 400, 400,
        (27, 27, 27, 33, 38, 38, 49, 55, 61, 66, 72, 77, 83, 89, 94, 100), dual=True,
    ),
    DmdType.DLP500YX: DmdModel(
        "DLP500YX", 2048, 1200, 5.4, (62, 184, 269, 458, 682, 807, 1083, 2263), 800, 400,
        (30, 30, 30, 30, 34, 38, 42, 46, 50, 54, 58, 62), dual=True,
    ),
    # TI tabulates no times for this one: the controller tells them (0x1A42), and refuses shorter ones (error 14).
    DmdType.DLP5500: DmdModel("DLP5500", 1024, 768, 10.8, None, 1024, 960),
}  # fmt: skip


def min_exposure_us(model: DmdModel, depth_bits: int, *, blocks: int | None = None) -> int:
    """Return the shortest time a pattern can be on show, µs.

    Args:
        model: The mirror device.
        depth_bits: 1 to 8.
        blocks: How many mirror blocks are loaded (1-bit patterns); None for all.
    """
    if blocks is not None:
        return model.block_us[blocks - 1]
    return model.min_exposure_us[depth_bits - 1] if model.min_exposure_us else 1


def max_patterns(model: DmdModel, depth_bits: int) -> int:
    """Return how many masks of this depth one sequence can hold, as limited by memory, entries or images."""
    images = MAX_IMAGES * patterns_per_image(depth_bits)
    return min(model.one_bit_capacity // depth_bits, model.max_entries, images)


def patterns_per_image(depth_bits: int) -> int:
    """Return how many masks of this depth share one 24-bit image."""
    return 24 // depth_bits


def upload_reports(block_bytes: int) -> int:
    """Return how many 64-byte reports one image block of `block_bytes` takes, announcement included."""
    whole, rest = divmod(block_bytes, CHUNK_BYTES)
    reports = 1 + whole * _reports(CHUNK_BYTES)
    return reports + (_reports(rest) if rest else 0)


def upload_s(block_bytes: int) -> float:
    """Return the least time that one image block takes over full-speed USB, seconds."""
    return upload_reports(block_bytes) * REPORT_PERIOD_S


def _reports(chunk_bytes: int) -> int:
    return -(-(chunk_bytes + _CHUNK_OVERHEAD_BYTES) // REPORT_BYTES)
