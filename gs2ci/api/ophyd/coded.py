"""A whole coded exposure as one ophyd-async reading: the capture of the rig file, at each point of any plan.

Here: `CodedExposure`. Not here: the capture itself (`gs2ci.api.rigs`).
"""

from pathlib import Path

import numpy as np
from ophyd_async.core import (
    AsyncStatus,
    PathProvider,
    StandardReadable,
    StandardReadableFormat,
    soft_signal_r_and_setter,
)

from gs2ci.api.ophyd.worker import Worker
from gs2ci.api.rigs import OpenRig
from gs2ci.core.progress import Silent
from gs2ci.core.storage import read_shot


class CodedExposure(StandardReadable):
    """Masks, sensor and stage as in [capture] of the rig file: `trigger` writes one shot file, `read` names it.

    It makes all checks of `gs2ci capture`; `gs2ci reconstruct` reads the file directly.

    Args:
        rig: The rig, its devices open.
        call: Its devices' thread; during a capture it does nothing else.
        places: Names the next file; an existing file is not replaced.
        name: Name in Bluesky's documents.
    """

    def __init__(self, rig: OpenRig, call: Worker, places: PathProvider, name: str = "") -> None:
        with self.add_children_as_readables(StandardReadableFormat.UNCACHED_SIGNAL):
            self.file, self._set_file = soft_signal_r_and_setter(str)
        with self.add_children_as_readables(StandardReadableFormat.HINTED_UNCACHED_SIGNAL):
            self.mean, self._set_mean = soft_signal_r_and_setter(float)
            self.saturated, self._set_saturated = soft_signal_r_and_setter(float)
        self._rig, self._call, self._places = rig, call, places
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        """Take the rig file's capture."""
        place = self._places(self.name)
        path = Path(place.directory_path) / f"{place.filename}.h5"
        mean, saturated = await self._call(self._record, path)
        self._set_file(str(path))
        self._set_mean(mean)
        self._set_saturated(saturated)

    def _record(self, path: Path) -> tuple[float, float]:
        """Capture; return the mean of the measurement, in full scales of one view, and the share that is saturated."""
        prepared = self._rig.plan(progress=Silent())
        shot = read_shot(self._rig.record(path, prepared, progress=Silent()))
        return float(np.mean(shot.measurement)), 0.0 if shot.saturated is None else float(np.mean(shot.saturated))
