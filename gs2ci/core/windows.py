"""Allowed sides of a square window, for the settings of stages that use one."""

from typing import Final

from gs2ci.core.errors import InputError

# Several times the largest useful side; a larger window only costs time and memory.
LARGEST_PX: Final = 255


def check_window(of: str, side_px: int, least_px: int) -> None:
    """Check the side of a window, which must be odd.

    Raises:
        InputError: It is even, below `least_px` or above `LARGEST_PX`; `of` names the window.
    """
    if not least_px <= side_px <= LARGEST_PX or side_px % 2 == 0:
        raise InputError(f"window of {side_px} px for {of}", allowed=f"odd numbers from {least_px} to {LARGEST_PX}")
