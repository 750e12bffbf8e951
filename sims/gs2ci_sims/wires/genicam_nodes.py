"""The features of the GenICam twin, after the Standard Features Naming Convention.

From SFNC 2.7 (EMVA), by chapters: Image Format Control (Width limits OffsetX and conversely, binning limits both; sizes
are locked while streaming), Acquisition Control (each trigger has its own mode, chosen by TriggerSelector; times are
in microseconds; ExposureMode TriggerWidth exposes while the line is held), Analog Control (gain, gamma), Chunk Data
Control, Transport Layer Control (TLParamsLocked), Device Control (TimestampLatch, TimestampLatchValue). Written values
stay until the camera loses power.

Here: `NodeTable`: values, limits, locks. Not here: the camera behind them (`genicam`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Literal

from gs2ci_drivers.ports import Feature, FeatureRefusalError, FeatureValue

Kind = Literal["integer", "float", "boolean", "enumeration", "string", "command", "other"]
Limit = Callable[[], float]
CATEGORIES: Final = {
    "ImageFormatControl": (
        "Width",
        "Height",
        "Offset",
        "PixelFormat",
        "Binning",
        "Decimation",
        "Reverse",
        "TestPattern",
    ),
    "AcquisitionControl": ("Acquisition", "Trigger", "Exposure", "SensorShutter"),
    "AnalogControl": ("Gain", "Gamma", "Black", "Balance"),
    "ChunkDataControl": ("Chunk",),
    "LUTControl": ("LUT",),
    "ColorTransformationControl": ("ColorTransformation",),
    "DeviceControl": ("Device", "Timestamp"),
    "DigitalIOControl": ("Line",),
    "ImageProcessingControl": ("",),
}
"""Category -> how the names of its features begin; the last one holds the rest."""


@dataclass
class Node:
    """One feature.

    Args:
        kind: Type of its value.
        value: Its present value.
        low: Its smallest value.
        high: Its largest value.
        step: Its step.
        symbols: Its entries.
        fixed: Whether it can only be read.
        locked: Whether it cannot be written while streaming.
        selector: The feature that selects it: it has one value for each of the selector's entries.
        read: Computes its value if it is not a written one.
        run: Executes it if it is a command.
        category: The chapter that it belongs to; features without one are not listed.
        unit: The unit of its value.
    """

    kind: Kind
    value: FeatureValue = 0
    low: Limit = lambda: 0.0
    high: Limit = lambda: 0.0
    step: float = 1.0
    symbols: tuple[str, ...] = ()
    fixed: bool = False
    locked: bool = False
    selector: str = ""
    read: Callable[[], FeatureValue] | None = None
    run: Callable[[], None] | None = None
    by_entry: dict[str, FeatureValue] = field(default_factory=dict)
    category: str = ""
    unit: str = ""


class NodeTable:
    """All features of a camera.

    Args:
        nodes: The features by name.
        streaming: Tells whether the camera streams.
    """

    def __init__(self, nodes: dict[str, Node], streaming: Callable[[], bool]) -> None:
        self._nodes = nodes
        self._streaming = streaming

    def __contains__(self, name: str) -> bool:
        return name in self._nodes

    def list(self) -> list[tuple[str, str]]:
        """Return category and name of each feature."""
        return [(node.category, name) for name, node in self._nodes.items() if node.category]

    def describe(self, name: str) -> Feature | None:
        """Return a feature's present value and limits; None if it does not exist."""
        node = self._nodes.get(name)
        if node is None:
            return None
        return Feature(
            kind=node.kind,
            readable=node.kind != "command",
            writable=not (node.fixed or (node.locked and self._streaming())),
            low=node.low(),
            high=node.high(),
            step=node.step,
            symbols=node.symbols,
            unit=node.unit,
            selectors=(node.selector,) if node.selector else (),
        )

    def read(self, name: str) -> FeatureValue:
        """Return a feature's value.

        Raises:
            FeatureRefusalError: The feature does not exist, or is a command.
        """
        node = self._node(name)
        if node.kind == "command":
            raise FeatureRefusalError(f"{name} cannot be read")
        if node.read is not None:
            return node.read()
        return node.by_entry.get(self._entry(node), node.value) if node.selector else node.value

    def of(self, name: str, entry: str) -> FeatureValue:
        """Return the value that a selected feature has for one entry of its selector."""
        node = self._node(name)
        return node.by_entry.get(entry, node.value)

    def write(self, name: str, value: FeatureValue) -> None:
        """Set a feature.

        Raises:
            FeatureRefusalError: The feature does not exist, is read-only or locked, or the value is not allowed.
        """
        node = self._node(name)
        if node.fixed or node.kind == "command":
            raise FeatureRefusalError(f"{name} cannot be written")
        if node.locked and self._streaming():
            raise FeatureRefusalError(f"{name} is locked while streaming (TLParamsLocked)")
        if node.kind == "enumeration" and value not in node.symbols:
            raise FeatureRefusalError(f"{name} has no entry {value!r}")
        if node.kind in ("integer", "float"):
            number = float(value)
            if not node.low() <= number <= node.high():
                raise FeatureRefusalError(f"{name} = {value} is not in {node.low()} to {node.high()}")
            if node.kind == "integer" and (number - node.low()) % node.step:
                raise FeatureRefusalError(f"{name} = {value} is no multiple of {node.step} from {node.low()}")
            value = int(number) if node.kind == "integer" else round(number / node.step) * node.step
        if node.selector:
            node.by_entry[self._entry(node)] = value
        else:
            node.value = value

    def put(self, name: str, value: FeatureValue) -> None:
        """Set a feature as the camera itself does, within no limits."""
        self._nodes[name].value = value

    def execute(self, name: str) -> None:
        """Run a command.

        Raises:
            FeatureRefusalError: The feature does not exist, or is not a command.
        """
        node = self._node(name)
        if node.run is None:
            raise FeatureRefusalError(f"{name} is no command")
        node.run()

    def number(self, name: str) -> float:
        """Return a number."""
        return float(self.read(name))

    def of_number(self, name: str, entry: str) -> float:
        """Return a number that a selected feature has for one entry of its selector."""
        return float(self.of(name, entry))

    def _entry(self, node: Node) -> str:
        return str(self._nodes[node.selector].value)

    def _node(self, name: str) -> Node:
        if name not in self._nodes:
            raise FeatureRefusalError(f"there is no feature {name}")
        return self._nodes[name]


def in_categories(nodes: dict[str, Node]) -> dict[str, Node]:
    """Return the features, each with its category unless it has one."""
    for name, node in nodes.items():
        begins = ((category, start) for category, starts in CATEGORIES.items() for start in starts)
        node.category = node.category or next(category for category, start in begins if name.startswith(start))
    return nodes
