"""What a square window may measure. For the settings of the stages that look through one."""

from typing import Final

from gs2ci.core.errors import InputError

# Several times what any of them gains from; beyond, a window only costs time and memory.
LARGEST_PX: Final = 255


def check_window(of: str, side_px: int, least_px: int) -> None:
    """Accept the side of a window that has a pixel in its middle.

    Raises:
        InputError: It is even, below `least_px` or beyond `LARGEST_PX`; `of` says whose window it is.
    """
    if not least_px <= side_px <= LARGEST_PX or side_px % 2 == 0:
        raise InputError(f"window of {side_px} px for {of}", allowed=f"odd numbers from {least_px} to {LARGEST_PX}")
