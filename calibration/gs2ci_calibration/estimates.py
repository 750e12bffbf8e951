"""A number with its standard error and unit, and the section of a bundle that a procedure returns.

Here: `Estimate`, `Section`. Not here: files (`bundle`), how anything is estimated (the procedures).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gs2ci.core.arrays import Bool
from gs2ci.core.errors import NumericsError

# Arrays of up to this many numbers are shown in full; of larger ones, the median.
MOST_SHOWN: Final = 6
# The same limit for output to programs.
MOST_RECORDED: Final = 64
# Powers of ten between which numbers are written without an exponent.
LEAST_POWER: Final = -4
MOST_POWER: Final = 6


@dataclass(frozen=True)
class Estimate:
    """A value, or an array of values, with one standard error each.

    Args:
        value: The estimate: a number or an array of any shape; float32 arrays stay float32.
        standard_error: One standard deviation of its error: a number for all of them, or an array of the value's
            shape. 0 only for values that are exact by definition.
        unit: "e/DN", "px", "s", "1" for a pure number.

    Raises:
        NumericsError: A value or standard error is not finite, a standard error is negative, or shapes disagree.
    """

    value: NDArray[np.floating]
    standard_error: NDArray[np.floating]
    unit: str

    def __init__(self, value: ArrayLike, standard_error: ArrayLike, unit: str) -> None:
        number, error = _floats(value), _floats(standard_error)
        if error.shape not in ((), number.shape):
            raise NumericsError(
                f"an estimate of shape {list(number.shape)} with standard errors of shape {list(error.shape)}",
                allowed="one standard error, or one for each value",
            )
        if not np.isfinite(number).all() or not np.isfinite(error).all() or (error < 0).any():
            raise NumericsError(
                f"an estimate in {unit} holds NaN, infinity or a negative standard error",
                allowed="finite numbers, standard errors of 0 or more",
                remedy="report this with the frames: the procedure should have refused them before",
            )
        object.__setattr__(self, "value", number)
        object.__setattr__(self, "standard_error", error)
        object.__setattr__(self, "unit", unit)

    def __float__(self) -> float:
        """Return the value of a single number."""
        return float(self.value)

    @property
    def error(self) -> float:
        """Get the standard error of a single number, or the rms of an array's."""
        return float(np.sqrt(np.mean(np.square(self.standard_error, dtype=np.float64))))

    def agrees(self, truth: ArrayLike, sigmas: float = 2.0) -> Bool:
        """Return whether a true value lies within `sigmas` standard errors of the estimate, elementwise."""
        return np.asarray(np.abs(self.value - np.asarray(truth)) <= sigmas * self.standard_error)

    def record(self) -> dict[str, Any]:
        """Return plain values: value, standard error, unit; of a large array the median, the rms error, its shape."""
        if self.value.size <= MOST_RECORDED:
            value, error = self.value.tolist(), np.broadcast_to(self.standard_error, self.value.shape).tolist()
            return {"value": value, "standard_error": error, "unit": self.unit}
        median = float(np.median(self.value))
        return {"median": median, "rms_error": self.error, "unit": self.unit, "shape": list(self.value.shape)}

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        if self.value.shape == ():
            return f"{with_error(float(self.value), float(self.standard_error))}{unit}"
        shape = " × ".join(str(side) for side in self.value.shape)
        errors = np.broadcast_to(self.standard_error, self.value.shape)
        # Values that are exact by definition, as a camera matrix's zeros and its one, were not estimated.
        found = list(zip(self.value[errors > 0].tolist(), errors[errors > 0].tolist(), strict=True))
        if 0 < len(found) <= MOST_SHOWN:
            return f"{', '.join(with_error(*one) for one in found)}{unit} [{shape}]"
        return f"median {with_error(float(np.median(self.value)), self.error)}{unit} [{shape}]"


def with_error(value: float, error: float) -> str:
    """Write a number with the digits that its standard error justifies: both to the error's second digit.

    Args:
        value: Finite.
        error: Its standard error, 0 or more; 0 for an exact number.
    """
    if error == 0:
        return f"{value:.6g} ± 0"
    decimals = 1 - math.floor(math.log10(error))
    power = math.floor(math.log10(max(abs(value), error)))
    if LEAST_POWER <= power <= MOST_POWER:
        return f"{_rounded(value, decimals)} ± {_rounded(error, decimals)}"
    decimals += power
    return f"({_rounded(value / 10.0**power, decimals)} ± {_rounded(error / 10.0**power, decimals)})e{power:+03d}"


def _rounded(value: float, decimals: int) -> str:
    """Write a number to `decimals` decimals, without the sign of a zero; below 0, tens and hundreds are rounded."""
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"


def _floats(values: ArrayLike) -> NDArray[np.floating]:
    array = np.array(values)
    kept = array if array.dtype == np.float32 else array.astype(np.float64)
    kept.flags.writeable = False
    return kept


@dataclass(frozen=True)
class Section:
    """The results of one procedure: one section of a bundle.

    Args:
        name: The procedure's name, as on the command line: "dark-flat".
        estimates: Estimates by name, with units; names are the field's terms.
        arrays: Numbers that are no estimates: patterns, flags (u1), indices. Finite.
        facts: Settings of the measurement as plain values: exposure_s, frames, mode, ...
        notes: Sentences that a user should read.
        measured_utc: Time of the measurement, ISO 8601.
        rig: Text of the rig file of the measurement; None before the section is added to a bundle, which fills it in.
        temperature_c: Temperature of the sensor then, by the rig file, or None.
    """

    name: str
    estimates: Mapping[str, Estimate]
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    measured_utc: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    rig: str | None = None
    temperature_c: float | None = None

    @property
    def known(self) -> Bool:
        """Get at which pixels a section of masks knows their transmission, [H, W]."""
        return self.arrays["valid"] > 0 if "valid" in self.arrays else np.ones(self.array("masks").shape[1:], np.bool_)

    def number(self, name: str) -> float:
        """Return a single estimate's value."""
        return float(self.estimates[name])

    def array(self, name: str) -> NDArray[Any]:
        """Return an array by name: an estimate's values, or one of `arrays`."""
        return self.estimates[name].value if name in self.estimates else self.arrays[name]

    def record(self) -> dict[str, Any]:
        """Return plain values, without the arrays, which the bundle holds."""
        return {
            "name": self.name,
            "measured_utc": self.measured_utc,
            "estimates": {name: estimate.record() for name, estimate in self.estimates.items()},
            "facts": dict(self.facts),
            "notes": list(self.notes),
        }
