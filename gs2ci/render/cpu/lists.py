"""Each cell's Gaussians, front to back: making these lists, and keeping them for the next renderings.

Between neighbouring iterations of a fit Gaussians move by hundredths of a pixel, and listing them is a quarter of the
work. So a rendering may take over the lists of an earlier one of the same population, made with every footprint widened
by a margin. Blending tests each pixel by itself: entries too many change nothing, and only what has left its margin, or
changed places in depth, is not as a fresh listing has it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import in_parts
from gs2ci.render.cpu.bins import OVERFLOW, SPAN, count_entries, fill_entries
from gs2ci.render.cpu.layout import Layout
from gs2ci.render.cpu.workspace import Lease, Pool, Workspace
from gs2ci.render.interface import Reuse
from gs2ci.render.simd.vector import LANES

_SPANS_PER_GAUSSIAN: Final = 4
"""First guess of the span buffer's size; it doubles until it suffices."""


@dataclass(frozen=True)
class Lists:
    """Which Gaussians may touch which cell.

    Args:
        entries: Length of each cell's list, [cells] int32.
        start: Where it begins within its view's lists, [cells] int32.
        view_start: Where each view's lists begin, [V + 1] int64.
        gaussians: Their indices, nearest first, [entries in all] int32.
    """

    entries: NDArray[np.int32]
    start: NDArray[np.int32]
    view_start: NDArray[np.int64]
    gaussians: NDArray[np.int32]


def list_gaussians(
    records: F32, count: int, layout: Layout, margin_px: float, scratch: Workspace, kept: Workspace
) -> Lists:
    """List each cell's Gaussians front to back.

    Args:
        records: Projected Gaussians, [V, blocks * 256].
        count: How many there are, G.
        layout: The cells.
        margin_px: Footprints count as wider by this on all sides.
        scratch: Where what is needed meanwhile lies.
        kept: Where the lists lie.
    """
    views = layout.views
    # Here and below memory that nobody needs yet: a backward pass sums there, blending lists there what touches pixels.
    work = scratch.get("sums", (views, 4, count + LANES)).view(np.uint32)
    entries = kept.get("entries", (layout.cells,), np.int32)
    start = kept.get("entry_start", (layout.cells,), np.int32)
    tables = (views, layout.strips * layout.width)
    found, totals = np.zeros(views, np.int64), np.zeros(views, np.int64)
    smallest = _SPANS_PER_GAUSSIAN * count + LANES * layout.strips
    capacity = max(smallest, scratch.capacity("touching") // max(SPAN * views, 1))
    while True:
        spans = scratch.get("touching", (views, SPAN * capacity), np.int32)
        in_parts(
            count_entries,
            views,
            records,
            records.view(np.uint32),
            count,
            (layout.height, layout.width),
            layout.strip_rows,
            np.float32(margin_px),
            layout.first.reshape(tables),
            layout.last.reshape(tables),
            layout.cell_start,
            work,
            spans,
            found,
            entries,
            start,
            totals,
        )
        if not (found == OVERFLOW).any():
            break
        capacity *= 2
    view_start = np.concatenate([np.zeros(1, np.int64), np.cumsum(totals)])
    gaussians = kept.get("listed", (int(view_start[-1]),), np.int32)
    in_parts(fill_entries, views, layout.cell_start, spans, found, start, view_start, gaussians)
    return Lists(entries, start, view_start, gaussians)


@dataclass(frozen=True)
class _Kept:
    """Lists, what they are of, and the memory in which they lie."""

    lists: Lists
    count: int
    layout: Layout
    lease: Lease


class CpuReuse(Reuse):
    """The lists of one population, for as many renderings as the settings say.

    Each listing leases a workspace and never writes to it again; it goes back to its pool when neither this object nor
    a graph that waits for its backward pass needs it. Not for two renderings at the same time.

    Args:
        pool: Where workspaces come from.
        every: Renderings per listing.
        margin_px: See `list_gaussians`.
    """

    def __init__(self, pool: Pool, every: int, margin_px: float) -> None:
        self.margin_px = margin_px
        self.listings = 0
        self._pool = pool
        self._every = every
        self._kept: _Kept | None = None
        self._left = 0

    def lists(self, count: int, layout: Layout, make: Callable[[Workspace], Lists]) -> tuple[Lists, Lease]:
        """Return the lists for the next rendering, and the lease that keeps their memory.

        Args:
            count: Number of Gaussians.
            layout: The cells.
            make: Lists them in a workspace; called when those there are have served their time, or are of another
                number of Gaussians or other cells.
        """
        kept = self._kept
        if kept is None or self._left == 0 or kept.count != count or kept.layout is not layout:
            self._kept = kept = None  # so that its memory may serve again at once
            lease = self._pool.lease()
            assert lease.workspace is not None
            self._kept = kept = _Kept(make(lease.workspace), count, layout, lease)
            self._left = self._every
            self.listings += 1
        self._left -= 1
        return kept.lists, kept.lease
