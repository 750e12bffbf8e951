"""Record what passes between the driver and a GenICam camera: features by name, and buffers.

Not here: the file's format (`trace`), what features mean (`gs2ci_drivers.genicam`).
"""

import json
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Final

from gs2ci_drivers.ports import CameraBuffer, FeatureValue
from gs2ci_drivers.trace import Call, TracedPort

# What methods return, as texts.
_TOLD: Final[dict[str, Callable[[Any], list[str]]]] = {
    "list_cameras": lambda found: [json.dumps(asdict(one)) for one in found],
    "open": lambda found: [json.dumps(asdict(found))],
    "list_features": lambda found: [json.dumps(found)],
    "describe": lambda found: [json.dumps(None if found is None else asdict(found))],
    "read": lambda value: [json.dumps(value)],
}


class TracedCamera(TracedPort):
    """A `CameraPort` that writes down what passes, pixels included."""

    def _outcome(self, call: Call, result: Any) -> None:
        super()._outcome(call, _TOLD[call.op](result) if call.op in _TOLD else result)

    def write(self, name: str, value: FeatureValue) -> None:
        """Write and note."""
        self._trace.note(Call("write", args=[name, json.dumps(value)]), lambda: self._port.write(name, value))

    def fetch(self, timeout_s: float) -> CameraBuffer | None:
        """Wait and note what came."""
        call = Call("fetch")

        def outcome(result: CameraBuffer | None) -> None:
            if result is not None:
                call.got = [result.data]
                call.result = [json.dumps({key: value for key, value in asdict(result).items() if key != "data"})]

        return self._trace.note(call, lambda: self._port.fetch(timeout_s), outcome)
