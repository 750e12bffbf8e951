"""A bench's devices for Bluesky, by ophyd-async: `ophyd_bench`. Calling it needs the extra `ophyd`.

Here: the entry point. Not here: the devices (`bench`), which need the extra when they are imported.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from gs2ci.core.extras import missing_extra

if TYPE_CHECKING:
    from ophyd_async.core import PathProvider

    from gs2ci.api.ophyd.bench import OphydBench
    from gs2ci.api.rigs import OpenRig


def ophyd_bench(rig: "OpenRig", places: "str | Path | PathProvider") -> "OphydBench":
    """Make an open rig available to Bluesky: modulator, sensor, axes, coded exposures as ophyd-async devices.

    Args:
        rig: The rig, from `open_rig`; until the bench is closed, only Bluesky uses its devices.
        places: The folder for frames and shots, or ophyd-async's own provider of paths.

    Returns:
        The bench, connected; used in a `with` statement, which leaves it at rest.

    Raises:
        DeviceError: A device does not answer.
        InputError: The extra `ophyd` is not installed, or the rig file's masks do not fit on the modulator.

    Example:
        >>> from bluesky import RunEngine, plans
        >>> with gs2ci.open_rig("rig.toml") as rig, gs2ci.ophyd_bench(rig, ".") as bench:
        ...     runs = RunEngine({})(plans.scan([bench.coded], bench.axes["x"], 74.0, 75.0, 2))
        >>> len(runs)
        1
    """
    try:
        from gs2ci.api.ophyd.bench import OphydBench
    except ModuleNotFoundError as error:
        raise missing_extra(error) or error from error
    return OphydBench(rig, places)
