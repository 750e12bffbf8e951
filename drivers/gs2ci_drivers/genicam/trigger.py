"""The trigger of a GenICam camera: Acquisition Control and Digital I/O Control of SFNC 2.7.

Here: `Trigger`. Not here: the rest of a set-up (`setup`), which imports it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from gs2ci_drivers.failures import UnsupportedError
from gs2ci_drivers.genicam.leftovers import DEBOUNCERS
from gs2ci_drivers.genicam.nodes import US, Features, seconds_per_unit
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.ports import FeatureValue
from gs2ci_drivers.sensor import TriggerMode

START_DELAYS: Final = ("BslExposureStartDelay",)
"""Time from a trigger to its exposure with the present settings, in microseconds; line, debouncer and TriggerDelay come
on top (docs.baslerweb.com/exposure-start-delay and /acquisition-timing-information)."""
OTHERS: Final = ("ExposureStart", "FrameBurstStart")
"""What else begins an exposure where there is no FrameStart: IDS' ("Then activate the ExposureStart trigger": IDS
Vision cameras, Using a software trigger), and the only one of many Hikrobots, of bursts of one (aravis issues 589 and
702)."""
OTHER_EDGE: Final = {"RisingEdge": ("Falling", "Low"), "FallingEdge": ("Rising", "Raising", "High")}
"""What the names of debouncers contain that delay the other edge."""
AS_WIRED: Final[dict[str, FeatureValue]] = {"LineMode": "Input", "LineInverter": False}
"""What the trigger's line has to be: an inverter lies before TriggerActivation (Teledyne Linea HS manual: "after any
processing by the line inverter module"), so that rising edges would be falling ones, a pulse later."""


def selected(features: Features, options: GenicamOptions) -> str:
    """Return which entry of TriggerSelector begins an exposure; "" if there is none."""
    return next((one for one in (options.trigger_selector, *OTHERS) if features.has("TriggerSelector", one)), "")


class Trigger:
    """What starts an exposure.

    Args:
        device: Name of the sensor.
        features: The camera's features.
        options: The rig file's table.
        notes: Receives a note for each setting of the line that another program had left otherwise.

    Attributes:
        delay_s: From a trigger to the start of its exposure, as set and as known.
    """

    def __init__(self, device: str, features: Features, options: GenicamOptions, notes: list[str]) -> None:
        self._device = device
        self._features = features
        self._options = options
        self._notes = notes
        self.delay_s = 0.0

    def stop_all(self) -> None:
        """Switch every trigger off: some lock other features while they are on, others would block the camera.

        Raises:
            DriverError: The camera refuses, or does not answer.
        """
        features = self._features
        features.write_if_there("AcquisitionMode", "Continuous")
        selector = features.find("TriggerSelector")
        if selector is None:
            features.write_if_there("TriggerMode", "Off")
            return
        for name in selector.symbols:
            features.write("TriggerSelector", name)
            features.write_if_there("TriggerMode", "Off")

    def set(self, mode: TriggerMode) -> None:
        """Set what starts an exposure: the camera's clock, an edge or a level.

        Raises:
            UnsupportedError: A delay is requested and the camera has none.
            DriverError: The camera refuses, has no such feature, or does not answer.
        """
        features, options = self._features, self._options
        if selector := selected(features, options):
            features.write("TriggerSelector", selector)
        features.write_if_there("TriggerMode", "Off")  # some cameras lock the rest while it is on
        self.delay_s = 0.0
        if mode is TriggerMode.FREE_RUN:
            features.write_if_there("ExposureMode", "Timed")
            return
        features.write("TriggerSource", options.trigger_line)
        # SFNC only recommends TriggerActivation: a camera without it takes rising edges.
        if options.trigger_activation != "RisingEdge" or features.has("TriggerActivation"):
            features.write("TriggerActivation", options.trigger_activation)
        features.write_if_there("ExposureMode", "TriggerWidth" if mode is TriggerMode.LEVEL else "Timed")
        if options.trigger_overlap:
            features.write("TriggerOverlap", options.trigger_overlap)
        set_s = self._set_delay_s()
        with self._line_chosen() as is_it:
            if is_it:
                self._wire()
            self.delay_s = set_s + self._debounced_s() + options.trigger_latency_s
        features.write("TriggerMode", "On")
        self.delay_s += sum(US * (features.number(name) or 0.0) for name in START_DELAYS)

    def _set_delay_s(self) -> float:
        """Set TriggerDelay to what is requested, or to its least; return it."""
        options = self._options
        # Without its switch a Point Grey's TriggerDelay has no effect (Chameleon3: TriggerDelayEnabled, False).
        self._features.write_if_there("TriggerDelayEnabled", options.trigger_delay_s > 0)
        delay = self._features.first(("TriggerDelay", "TriggerDelayAbs"))
        if delay is not None:
            unit_s = seconds_per_unit(self._device, *delay)
            least = delay[1].low if not options.trigger_delay_s else 0.0
            return unit_s * float(self._features.write(delay[0], max(options.trigger_delay_s / unit_s, least)))
        if options.trigger_delay_s:
            raise UnsupportedError(
                self._device,
                "the camera has no feature TriggerDelay",
                asked="configure",
                remedy="leave trigger_delay_s in [sensor] out",
            )
        return 0.0

    @contextmanager
    def _line_chosen(self) -> Iterator[bool]:
        """Choose the trigger's line where lines are chosen; tell whether it is that one, and put the choice back."""
        features, line = self._features, self._options.trigger_line
        before = features.read("LineSelector") if features.has("LineSelector", line) else None
        if before is not None:
            features.write("LineSelector", line)
        try:
            yield before is not None or not features.has("LineSelector")
        finally:
            if before is not None:
                features.write("LineSelector", before)

    def _wire(self) -> None:
        """Have the chosen line take edges as they are, and at once: another line may have had no debouncer to reset."""
        features = self._features
        for name, neutral in (AS_WIRED | dict.fromkeys(DEBOUNCERS, 0.0)).items():
            found = features.find(name)
            if found is None or not (found.readable and found.writable) or name in self._options.features:
                continue
            wanted = max(neutral, found.low) if isinstance(neutral, float) else neutral
            if (left := features.read(name)) != wanted:
                features.write(name, wanted)
                edge, other = "trigger_activation in [sensor] chooses the edge", "[sensor.features] can set it"
                self._notes.append(
                    f"{self._device}: {name} of {self._options.trigger_line} was {left} and has been reset to "
                    f"{wanted}; {edge if name in AS_WIRED else other}"
                )

    def _debounced_s(self) -> float:
        """Return how much later an edge acts, because its level has to last."""
        longest_s, others = 0.0, OTHER_EDGE[self._options.trigger_activation]
        for name in DEBOUNCERS:
            found = None if any(part in name for part in others) else self._features.find(name)
            time = self._features.number(name) if found is not None else None
            if found is not None and time:
                longest_s = max(longest_s, time * seconds_per_unit(self._device, name, found))
        return longest_s
