"""Record what passes between the driver and a GenICam camera: features by name, and buffers.

Not here: the file's format (`trace`), what features mean (`gs2ci_drivers.genicam`).
"""

import json
from collections.abc import Callable
from dataclasses import asdict
from typing import TypeVar

from gs2ci_drivers.ports import CameraBuffer, CameraIdentity, CameraPort, Feature, FeatureRefusalError, FeatureValue
from gs2ci_drivers.trace import Call, TracedPort

T = TypeVar("T")


class TracedCamera(TracedPort[CameraPort]):
    """A `CameraPort` that writes down what passes, pixels included."""

    def list_cameras(self, producer: str) -> list[CameraIdentity]:
        """List and note."""
        call = Call("list_cameras", args=[producer])
        return self._trace.note(
            call,
            lambda: self._port.list_cameras(producer),
            lambda found: call.returned([_text(asdict(one)) for one in found]),
        )

    def open(self, producer: str, serial: str) -> CameraIdentity:
        """Open and note who answered."""
        call = Call("open", args=[producer, serial])
        return self._trace.note(
            call, lambda: self._port.open(producer, serial), lambda found: call.returned([_text(asdict(found))])
        )

    def list_features(self) -> list[tuple[str, str]]:
        """List and note."""
        call = Call("list_features")
        return self._trace.note(call, self._port.list_features, lambda found: call.returned([_text(found)]))

    def describe(self, name: str) -> Feature | None:
        """Request a feature's state and note it."""
        call = Call("describe", args=[name])
        return self._trace.note(
            call,
            lambda: self._port.describe(name),
            lambda found: call.returned([_text(None if found is None else asdict(found))]),
        )

    def read(self, name: str) -> FeatureValue:
        """Read and note."""
        call = Call("read", args=[name])
        return self._trace.note(
            call, lambda: _told(call, lambda: self._port.read(name)), lambda value: call.returned([_text(value)])
        )

    def write(self, name: str, value: FeatureValue) -> None:
        """Write and note."""
        call = Call("write", args=[name, _text(value)])
        self._trace.note(call, lambda: _told(call, lambda: self._port.write(name, value)))

    def execute(self, name: str) -> None:
        """Run and note."""
        call = Call("execute", args=[name])
        self._trace.note(call, lambda: _told(call, lambda: self._port.execute(name)))

    def start(self, buffers: int, chunks: tuple[str, ...]) -> int:
        """Begin and note."""
        call = Call("start", args=[buffers, *chunks])
        return self._trace.note(call, lambda: _told(call, lambda: self._port.start(buffers, chunks)))

    def fetch(self, timeout_s: float) -> CameraBuffer | None:
        """Wait and note what came."""
        call = Call("fetch")

        def outcome(result: CameraBuffer | None) -> None:
            if result is not None:
                call.got = [result.data]
                told = {key: value for key, value in asdict(result).items() if key != "data"}
                call.result = [_text(told)]

        return self._trace.note(call, lambda: _told(call, lambda: self._port.fetch(timeout_s)), outcome)

    def stop(self) -> None:
        """End and note."""
        call = Call("stop")
        self._trace.note(call, lambda: _told(call, self._port.stop))

    def clock_ns(self) -> int:
        """Get the computer's time and note it: the camera's is compared with it."""
        return self._trace.note(Call("clock_ns"), self._port.clock_ns)

    def close(self) -> None:
        """Close the port; the trace goes on, a camera that went away may be opened again."""
        self._trace.note(Call("close"), self._port.close)


def _told(call: Call, action: Callable[[], T]) -> T:
    """Do something that the camera may refuse; put its refusal into the call."""
    try:
        return action()
    except FeatureRefusalError as error:
        call.error = str(error)
        raise


def _text(value: object) -> str:
    return json.dumps(value)
