"""Reading and writing a camera's features, with typed errors and a record of what was set.

Here: reading and writing features by the names of the Standard Features Naming Convention (SFNC), and the two older
spellings of exposure and gain. Not here: which features make up a set-up (`setup`), time (`camera_clock`).
"""

from gs2ci_drivers.failures import OutOfRangeError, UnsupportedError
from gs2ci_drivers.ports import CameraPort, Feature, FeatureValue, port_errors

EXPOSURES = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
"""SFNC 2 and SFNC 1, both in microseconds; Ricoh's only one, whole microseconds (aravis 98c2d790, arvcamera.c,
arv_camera_set_exposure_time: ARV_CAMERA_SERIES_RICOH). Where others have the last, they have another, too."""
GAINS = ("Gain", "GainAbs")
"""SFNC 2 and SFNC 1; by the node's unit in decibels or a factor (Chromasens)."""
US = 1e-6
SECONDS = {"us": US, "µs": US, "μs": US, "": US, "ns": 1e-9, "ms": 1e-3, "s": 1.0}
"""Seconds per unit of a time, by the node's unit; SFNC's is the microsecond, also where a camera names none."""
FACTORS = ("x", "X", "times", "factor")


def in_decibels(gain: Feature) -> bool | None:
    """Return whether a gain is in decibels, False if it is a factor, None if its unit does not tell."""
    if gain.unit.strip().lower() == "db":
        return True
    return False if gain.unit.strip() in FACTORS else None


def seconds_per_unit(device: str, name: str, feature: Feature) -> float:
    """Return the length of a time's unit.

    Raises:
        UnsupportedError: The camera names a unit that is none of time.
    """
    unit = feature.unit.strip()
    if unit not in SECONDS:
        raise UnsupportedError(
            device,
            f"{name} has the unit {unit!r}",
            asked="configure",
            allowed=", ".join(filter(None, SECONDS)),
            remedy="see the camera's manual: this feature is no time, or the camera is none of the standard's",
        )
    return SECONDS[unit]


class Features:
    """The features of one open camera.

    Args:
        device: Name of the sensor, for messages.
        port: The camera.
    """

    def __init__(self, device: str, port: CameraPort) -> None:
        self.device = device
        self._port = port

    def list(self) -> list[tuple[str, str]]:
        """List category and name of every feature."""
        with port_errors(self.device, "list the features"):
            return self._port.list_features()

    def find(self, name: str) -> Feature | None:
        """Return the present state of a feature; None if there is none of that name."""
        with port_errors(self.device, f"describe {name}"):
            return self._port.describe(name)

    def first(self, names: tuple[str, ...]) -> tuple[str, Feature] | None:
        """Return the first of several spellings that the camera has, and the feature's state."""
        for name in names:
            found = self.find(name)
            if found is not None:
                return name, found
        return None

    def has(self, name: str, symbol: str = "") -> bool:
        """Return whether there is a feature of that name and, if `symbol` is given, such an entry in it."""
        found = self.find(name)
        return found is not None and (not symbol or symbol in found.symbols)

    def number(self, name: str) -> float | None:
        """Return a number, or None if the feature is missing or not readable now."""
        found = self.find(name)
        if found is None or not found.readable:
            return None
        value = self.read(name)
        return None if isinstance(value, str) else float(value)

    def read(self, name: str) -> FeatureValue:
        """Read a feature.

        Raises:
            RefusedError: The camera refuses.
            LinkError: It does not answer.
        """
        with port_errors(self.device, f"read {name}"):
            return self._port.read(name)

    def write(self, name: str, value: FeatureValue) -> FeatureValue:
        """Write a feature, an integer one to its nearest step, and return its value afterwards.

        Raises:
            UnsupportedError: There is no such feature, or no such entry.
            OutOfRangeError: A number beyond its limits.
            RefusedError: The camera refuses.
            LinkError: It does not answer.
        """
        found = self.find(name)
        if found is None:
            raise UnsupportedError(
                self.device,
                f"the camera has no feature {name}",
                asked=f"{name} = {value}",
                remedy="see the camera's manual or its maker's viewer for the features it has",
            )
        if found.kind == "enumeration" and value not in found.symbols:
            raise UnsupportedError(
                self.device,
                f"{name} has no entry {value!r}",
                asked=f"{name} = {value}",
                allowed=", ".join(found.symbols),
            )
        numeric = found.kind in ("integer", "float") and not isinstance(value, str)
        if numeric and not found.low <= float(value) <= found.high:
            raise OutOfRangeError(
                self.device,
                f"{name} = {value}",
                asked="configure",
                allowed=f"{found.low:g} to {found.high:g}" + (f" by {found.step:g}" if found.step != 1 else ""),
            )
        if found.kind == "integer" and isinstance(value, float):  # times may be integers: XIMEA's ExposureTime
            steps = min(round((value - found.low) / found.step), (found.high - found.low) // found.step)
            value = int(found.low + steps * found.step)
        with port_errors(self.device, f"{name} = {value}"):
            self._port.write(name, value)
        return self.read(name) if found.readable else value

    def write_if_there(self, name: str, value: FeatureValue) -> None:
        """Write a feature if the camera has it, has this entry in it, and allows writing now."""
        found = self.find(name)
        if found is not None and found.writable and (found.kind != "enumeration" or value in found.symbols):
            self.write(name, value)

    def execute(self, name: str) -> None:
        """Run a command.

        Raises:
            RefusedError: The camera refuses.
            LinkError: It does not answer.
        """
        with port_errors(self.device, name):
            self._port.execute(name)
