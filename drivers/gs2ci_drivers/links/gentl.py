"""GenICam cameras by their makers' GenTL producers: a `CameraPort` on harvesters (Apache-2.0) and EMVA's bindings.

Here: the calls. Not here: what features mean (`gs2ci_drivers.genicam`). Needs the extra `genicam`, which is imported
only when a camera is opened.
"""

import errno
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci_drivers.failures import UnsupportedError
from gs2ci_drivers.ports import CameraBuffer, CameraIdentity, Feature, FeatureRefusalError, FeatureValue

PATHS: Final = "GENICAM_GENTL64_PATH"
"""Environment variable with the folders of installed producers (GenTL standard 1.6)."""
SHORTEST_FETCH_S: Final = 1e-3
"""harvesters takes a timeout of 0 as endless."""
KINDS: Final = {
    "IInteger": "integer",
    "IFloat": "float",
    "IBoolean": "boolean",
    "IEnumeration": "enumeration",
    "IString": "string",
    "ICommand": "command",
}
COMMAND_S: Final = 2.0
"""How long a command of the camera may take."""


class GenTlPort:
    """One camera of one producer.

    Args:
        device: Name of the sensor, for messages.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._harvester: Any = None
        self._acquirer: Any = None
        self.incomplete = 0
        """How many buffers came incomplete so far."""
        self._chunks: tuple[str, ...] = ()

    def list_cameras(self, producer: str) -> list[CameraIdentity]:
        """List the cameras of a producer; see `CameraPort`."""
        return [_identity(info) for info in self._load(producer).device_info_list]

    def open(self, producer: str, serial: str) -> CameraIdentity:
        """Open a camera; see `CameraPort`.

        Raises:
            OSError: ENOENT: none, or several and no serial number; EBUSY: another program uses it.
        """
        cameras = self.list_cameras(producer)
        matching = [index for index, one in enumerate(cameras) if not serial or one.serial == serial]
        if len(matching) != 1:
            self.close()
            named = ", ".join(f"{one.serial} ({one.model})" for one in cameras) or "none"
            raise OSError(errno.ENOENT, f"{len(matching)} cameras match {serial!r}; there are: {named}")
        # harvesters replaces the main thread's SIGINT handler and never restores it: Ctrl-C would have no effect.
        main = threading.current_thread() is threading.main_thread()
        handler = signal.getsignal(signal.SIGINT) if main else None
        try:
            with _gentl_errors("open"):
                self._acquirer = self._harvester.create(matching[0])
        finally:
            if main:
                signal.signal(signal.SIGINT, handler)
        self._acquirer.add_callback(self._acquirer.Events.INCOMPLETE_BUFFER, _counter(self))
        return cameras[matching[0]]

    def list_features(self) -> list[tuple[str, str]]:
        """List the features below the camera's root category, if it has one; see `CameraPort`."""
        found: list[tuple[str, str]] = []
        with _gentl_errors("Root"):
            root: Any = getattr(self._nodes, "Root", None)
            waiting = [] if root is None else [("Root", root)]
            for category, node in waiting:
                for one in node.features:
                    if type(one).__name__ == "ICategory":
                        waiting.append((one.node.name, one))
                    else:
                        found.append((category, one.node.name))
        return found

    def describe(self, name: str) -> Feature | None:
        """Return the state of a feature; see `CameraPort`."""
        from genicam.genapi import EAccessMode  # noqa: PLC0415

        with _gentl_errors(name):
            node: Any = getattr(self._nodes, name, None)
            access = node.get_access_mode() if hasattr(node, "get_access_mode") else EAccessMode.NI
            if access in (EAccessMode.NI, EAccessMode.NA):
                return None
            kind: Any = KINDS.get(type(node).__name__, "other")
            readable = access in (EAccessMode.RO, EAccessMode.RW)
            limited = kind in ("integer", "float") and readable
            return Feature(
                kind=kind,
                readable=readable,
                writable=access in (EAccessMode.WO, EAccessMode.RW),
                low=float(node.min) if limited else 0.0,
                high=float(node.max) if limited else 0.0,
                step=float(node.inc) if limited and kind == "integer" else 1.0,
                symbols=tuple(node.symbolics) if kind == "enumeration" else (),
                unit=str(node.unit) if kind in ("integer", "float") else "",
                selectors=tuple(one.node.name for one in node.node.selecting_features),
            )

    def read(self, name: str) -> FeatureValue:
        """Read a feature; see `CameraPort`."""
        with _gentl_errors(name):
            return self._node(name).value

    def write(self, name: str, value: FeatureValue) -> None:
        """Write a feature; see `CameraPort`."""
        with _gentl_errors(name):
            node = self._node(name)
            number = type(node).__name__ == "IFloat" and not isinstance(value, str)
            node.value = float(value) if number else value

    def execute(self, name: str) -> None:
        """Run a command and wait for its end; see `CameraPort`."""
        with _gentl_errors(name):
            node = self._node(name)
            node.execute()
            until_s = time.monotonic() + COMMAND_S
            while not node.is_done():
                if time.monotonic() > until_s:
                    raise TimeoutError(f"{name} did not end")

    def start(self, buffers: int, chunks: tuple[str, ...]) -> int:
        """Begin the acquisition; see `CameraPort`."""
        with _gentl_errors("AcquisitionStart"):
            self._acquirer.num_buffers = max(buffers, self._acquirer.min_num_buffers)
            self._chunks = chunks
            self._acquirer.start()
            return int(self._acquirer.num_buffers)

    def fetch(self, timeout_s: float) -> CameraBuffer | None:
        """Wait for a buffer; see `CameraPort`."""
        before = self.incomplete
        with _gentl_errors("fetch"):
            raw = self._acquirer.try_fetch(timeout=max(timeout_s, SHORTEST_FETCH_S), is_raw=True)
            if raw is None:
                # harvesters queues an incomplete buffer again at once: only the fact that there was one is known.
                return None if self.incomplete == before else CameraBuffer(b"", False, -1, None)
            try:
                return self._copy(raw)
            finally:
                raw.parent.queue_buffer(raw)

    def stop(self) -> None:
        """End the acquisition; see `CameraPort`."""
        if self._acquirer is not None and self._acquirer.is_acquiring():
            with _gentl_errors("AcquisitionStop"):
                self._acquirer.stop()

    def clock_ns(self) -> int:
        """Get the computer's monotonic time."""
        return time.clock_gettime_ns(time.CLOCK_MONOTONIC)

    def close(self) -> None:
        """Release camera and producer; a second call does nothing."""
        acquirer, self._acquirer = self._acquirer, None
        harvester, self._harvester = self._harvester, None
        with suppress(Exception):  # a camera that is gone cannot be stopped
            if acquirer is not None:
                acquirer.destroy()
        with suppress(Exception):
            if harvester is not None:
                harvester.reset()

    @property
    def _nodes(self) -> Any:
        if self._acquirer is None:
            raise OSError(errno.ENODEV, "the camera is not open")
        return self._acquirer.remote_device.node_map

    def _node(self, name: str) -> Any:
        node = getattr(self._nodes, name, None)
        if node is None:
            raise FeatureRefusalError(f"there is no feature {name}")
        return node

    def _copy(self, raw: Any) -> CameraBuffer:
        height, width = _told(raw, "height"), _told(raw, "width")
        padding = _told(raw, "padding_x")
        data = raw.raw_buffer
        offset = _told(raw, "image_offset")
        # Bits 16 to 23 of a format's number are the bits that a pixel takes (PFNC 2.4).
        bits = _told(raw, "pixel_format") >> 16 & 0xFF
        size = height * (-(-width * bits // 8) + padding) or len(data)
        image = np.frombuffer(data, np.uint8, min(size, len(data) - offset), offset).tobytes()
        stamp = _told(raw, "timestamp", None)
        nodes, chunks = self._nodes, {}
        for name in self._chunks:
            with suppress(Exception):  # a chunk that this frame lacks
                chunks[name] = getattr(nodes, name).value
        return CameraBuffer(image, True, _told(raw, "frame_id", -1), stamp, height, width, padding, chunks)

    def _load(self, producer: str) -> Any:
        try:
            from harvesters.core import Harvester  # noqa: PLC0415
        except ImportError as error:
            raise UnsupportedError(
                self._device,
                "GenICam cameras need the extra `genicam`",
                asked="open",
                remedy="pip install 'gs2ci[genicam]'",
            ) from error
        self.close()
        self._harvester = Harvester()
        with _gentl_errors("open"):
            for path in find_producers(producer):
                self._harvester.add_file(str(path), check_existence=True)
            self._harvester.update()
        return self._harvester


def find_producers(producer: str) -> list[Path]:
    """Return the .cti files to load.

    Args:
        producer: One of them, or "" for those in the folders of GENICAM_GENTL64_PATH.

    Raises:
        OSError: ENOENT: there is none.
    """
    if producer:
        found = [Path(producer).expanduser()]
    else:
        folders = [Path(part) for part in os.environ.get(PATHS, "").split(os.pathsep) if part]
        found = sorted(path for folder in folders for path in folder.glob("*.cti"))
    if not found or not all(path.is_file() for path in found):
        what = producer or f"no .cti file in the folders of {PATHS}"
        raise OSError(
            errno.ENOENT, f"no GenTL producer: {what}; install the camera maker's, set `producer` in [sensor]"
        )
    return found


def _identity(info: Any) -> CameraIdentity:
    def told(name: str) -> str:
        try:
            return str(getattr(info, name))
        except Exception:
            return ""

    return CameraIdentity(told("vendor"), told("model"), told("serial_number"), told("tl_type"))


def _told(raw: Any, name: str, default: Any = 0) -> Any:
    """Return a property of a buffer as the producer reports it, or the default if it does not."""
    try:
        value = getattr(raw, name)
    except Exception:
        return default
    return default if value is None else value


def _counter(port: GenTlPort) -> Any:
    from harvesters.core import Callback  # noqa: PLC0415

    class Counter(Callback):  # type: ignore[misc]
        def emit(self, context: object = None) -> None:
            port.incomplete += 1

    return Counter()


@contextmanager
def _gentl_errors(asked: str) -> Iterator[None]:
    """Turn the bindings' errors into those that ports raise."""
    from genicam import genapi, gentl  # noqa: PLC0415

    refusals = (
        genapi.AccessException,
        genapi.OutOfRangeException,
        genapi.InvalidArgumentException,
        genapi.PropertyException,
        genapi.LogicalErrorException,
    )
    try:
        yield
    except refusals as error:
        raise FeatureRefusalError(str(error)) from error
    except (gentl.AccessDeniedException, gentl.ResourceInUseException) as error:
        raise OSError(errno.EBUSY, f"{asked}: {error}") from error
    except (genapi.TimeoutException, gentl.TimeoutException) as error:
        raise TimeoutError(f"{asked}: {error}") from error
    except (genapi.GenericException, gentl.GenericException) as error:
        raise OSError(errno.ENODEV, f"{asked}: {error}") from error
