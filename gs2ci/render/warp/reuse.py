"""What renderings of one population share: the lists of Gaussians, and the memory in which launches stay the same.

Here: for how long they serve. Not here: how they are made (`lists.py`, `arrays.py`).
"""

from typing import Any, Final
from weakref import WeakSet

from gs2ci.render.interface import Reuse
from gs2ci.render.warp.arrays import DeviceArrays, DeviceArraysKey
from gs2ci.render.warp.lists import BlockLists, list_gaussians

_SPARE: Final = 0.2
"""Memory for lists is larger than the first ones need by this share: a scene that is fitted grows and shrinks little
between two density rules, and lists that stay in place leave what is captured valid."""


class WarpReuse(Reuse):
    """The lists of one population, for as many renderings as the settings say, and the memory of a rendering.

    Args:
        every: Renderings per listing.
        margin_px: Footprints count as wider by this on all sides when lists are made.
    """

    def __init__(self, every: int, margin_px: float) -> None:
        self.margin_px = margin_px
        self.listings = 0
        self._every = every
        self._arrays: DeviceArrays | None = None
        self._lists: BlockLists | None = None
        self._listed: tuple[int, Any] | None = None
        self._left = 0
        self._users: WeakSet[Any] = WeakSet()

    def arrays(self, key: DeviceArraysKey) -> DeviceArrays:
        """Return the memory for a rendering: the one that is kept if it fits and nobody needs its contents still."""
        kept = self._arrays
        if kept is not None and kept.key == key and not self._users:
            return kept
        new = DeviceArrays(key)
        if not self._users:
            self._arrays = new
        return new

    def lists(self, arrays: DeviceArrays) -> BlockLists:
        """Return lists that still serve, or make new ones of what was projected."""
        listed = (arrays.key.gaussians, arrays.key.coding)
        same = self._lists is not None and self._listed == listed
        if same and self._left > 0 and self._lists is not None:
            self._left -= 1
            return self._lists
        room = self._lists if same and not self._users else None
        self._lists, self._listed = list_gaussians(arrays, room, _SPARE), listed
        self._left = self._every - 1
        self.listings += 1
        return self._lists

    @property
    def entries(self) -> int:
        """Get how many entries the lists have that serve now."""
        return 0 if self._lists is None else self._lists.total

    def used_by(self, rendering: object) -> None:
        """Let what a rendering was given stay as it is, until it is differentiated or forgotten."""
        self._users.add(rendering)

    def left_by(self, rendering: object) -> None:
        """Note that a rendering was differentiated."""
        self._users.discard(rendering)
