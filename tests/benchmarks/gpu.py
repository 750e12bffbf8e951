"""What only a GPU can tell, in one run of at most 15 minutes, the most telling first.

    python -m tests.benchmarks gpu                                     on the first CUDA device
    GS2CI_PARTS=errors,races python -m tests.benchmarks gpu            some parts alone
    GS2CI_DEVICE=cpu GS2CI_SMALL=1 python -m tests.benchmarks gpu      the flow of all, by fibers

Each part is begun only if the time that it may take is left (`GS2CI_MINUTES`, 15): parts that are left out are named at
the end, and the first command that runs them. A part that fails says how, and the next one begins. Here: the plan. Not
here: the parts (`gpu_parts`).
"""

import os
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gs2ci.render.settings import RasterSettings
from tests.benchmarks import gpu_parts
from tests.benchmarks.gpu_parts import Asked

MINUTES = 15.0


@dataclass(frozen=True)
class Part:
    """One part.

    Args:
        name: For `GS2CI_PARTS`.
        run: Prints its figures.
        most_s: How long it may take, a guess with room to spare: nothing of it was ever measured.
    """

    name: str
    run: Callable[[Asked], None]
    most_s: float


PLAN = (
    Part("errors", gpu_parts.errors, 90),
    Part("iterations", gpu_parts.iterations, 120),
    Part("standard", gpu_parts.standard, 240),
    Part("draft", gpu_parts.draft, 60),
    Part("worst_kernel", gpu_parts.worst_kernel, 20),
    Part("races", gpu_parts.races, 200),
    Part("beside_gsplat", gpu_parts.beside_gsplat, 120),
    Part("large_draft", gpu_parts.large_draft, 120),
    Part("exponent", gpu_parts.exponent, 180),
)


def run() -> None:
    """Print the figures."""
    import warp as wp  # noqa: PLC0415  an extra

    from gs2ci.reconstruct.settings import Settings  # noqa: PLC0415
    from gs2ci.render.warp.backend import WarpBackend  # noqa: PLC0415

    raster: RasterSettings = Settings().raster
    asked = Asked(WarpBackend(raster, os.environ.get("GS2CI_DEVICE")), bool(os.environ.get("GS2CI_SMALL")))
    print(f"device: {wp.get_device(asked.place).name}; warp {wp.config.version}")
    wanted = os.environ.get("GS2CI_PARTS", "")
    left_out = within(chosen(wanted), asked, 60 * float(os.environ.get("GS2CI_MINUTES", MINUTES)))
    if left_out:
        names = ",".join(part.name for part in left_out)
        print(f"\nleft out for want of time: GS2CI_PARTS={names} python -m tests.benchmarks gpu")


def chosen(names: str) -> tuple[Part, ...]:
    """Return the parts of these names, joined by commas, in the plan's order; all if there are none."""
    wanted = [name for name in names.split(",") if name]
    unknown = sorted(set(wanted) - {part.name for part in PLAN})
    if unknown:
        raise SystemExit(f"no part {', '.join(unknown)}: {', '.join(part.name for part in PLAN)}")
    return tuple(part for part in PLAN if not wanted or part.name in wanted)


def within(parts: Sequence[Part], asked: Asked, seconds: float) -> list[Part]:
    """Run the parts for which there is time, one after the other; return the others."""
    ends, left_out = time.monotonic() + seconds, []
    for part in parts:
        if time.monotonic() + part.most_s > ends:
            left_out.append(part)
            continue
        began = time.monotonic()
        print(f"\n== {part.name}: {(part.run.__doc__ or '').splitlines()[0]}", flush=True)
        try:
            part.run(asked)
        except Exception:
            print(f"{part.name} FAILS\n{traceback.format_exc()}", flush=True)
        print(f"({part.name} took {time.monotonic() - began:.0f} s of {part.most_s:.0f})", flush=True)
    return left_out
