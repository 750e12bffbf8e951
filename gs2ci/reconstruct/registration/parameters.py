"""The parameters of the masks' errors: the one list that registration, its report and corrections of bundles read.

A new correction is one entry here and its effect in `misfit`. Here: names, units, steps, limits, what lets a parameter
in, and what is said of it. Not here: the parameters' effect on masks (`misfit`, `placement`) and their estimation.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias

# Coefficients of the field are displacements at this distance, so that they do not depend on the picture's size.
FIELD_AT_PX: Final = 100.0
# Elements wider by more than half a pixel at each edge close the gaps between them.
MOST_WIDENING_PX: Final = 0.5
# Smaller displacements of the masks cost less than 0.05 dB.
MATTERS_PX: Final = 0.02
# Step of numerical derivatives: this displacement at the picture's corner.
STEP_PX: Final = 0.1
# A parameter is let in if it differs from its default by so many standard errors: the rest of the model is not exact.
SIGNIFICANT: Final = 5.0
# Fewer for the parameters of light, whose standard errors already include the bias by the scene.
_SIGNIFICANT_LIGHT: Final = 4.0
_ANY: Final = (-math.inf, math.inf)

Words: TypeAlias = Callable[[Mapping[str, float], Mapping[str, float]], str]
"""From values and standard errors, by name, to what is said of a group."""


@dataclass(frozen=True)
class Parameter:
    """One error of the masks.

    Args:
        name: Its name, which ends with its unit.
        unit: Of its values.
        per_px: For a displacement: the change that displaces a corner one pixel from the middle by a pixel; None for
            light.
        power: For a displacement: that of the distance with which it grows.
        step: For light: of numerical derivatives; in units of the mean reading if `of_reading`.
        least: For light: the smallest value that matters, likewise.
        of_reading: Step and least value are shares of the mean reading.
        limits: Between which it is estimated.
        inflation: Factor on its standard error. A real scene is not constant: texture finer than the windows biases the
            parameters of light by about their standard error. The factors give |z| the expected distribution for shots
            with right masks (`python -m tests.benchmarks right_shots`, first hundred draws; positions need none).
        errors: From how many standard errors on it is let in.
        most_apart: Estimates from several shots may differ by so much, whatever their errors.
    """

    name: str
    unit: str
    per_px: float | None = None
    power: int = 0
    step: float = 0.0
    least: float = 0.0
    of_reading: bool = False
    limits: tuple[float, float] = _ANY
    inflation: float = 1.0
    errors: float = SIGNIFICANT
    most_apart: float = 0.1

    def step_at(self, corner_px: float, reading: float) -> float:
        """Return the step of numerical derivatives, for a corner at this distance and this mean reading."""
        return self._scaled(STEP_PX, self.step, corner_px, reading)

    def least_at(self, corner_px: float, reading: float) -> float:
        """Return the smallest value that matters, likewise."""
        return self._scaled(MATTERS_PX, self.least, corner_px, reading)

    def _scaled(self, moved_px: float, of_light: float, corner_px: float, reading: float) -> float:
        if self.per_px is not None:
            return moved_px * self.per_px / corner_px**self.power
        return of_light * reading if self.of_reading else of_light


@dataclass(frozen=True)
class Group:
    """Parameters that are let in together, and what is said of them."""

    parameters: tuple[Parameter, ...]
    words: Words

    @property
    def names(self) -> tuple[str, ...]:
        """Get the parameters' names."""
        return tuple(one.name for one in self.parameters)


def _with(template: str) -> Words:
    """Return what fills a template: values by their names, standard errors as `e_NAME`."""
    return lambda values, errors: template.format(**values, **{f"e_{name}": error for name, error in errors.items()})


def _turned(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    turn = f"turned by {values['rotation_deg']:+.4f} ± {errors['rotation_deg']:.4f}°"
    return f"{turn} and scaled by {1 + values['scale']:.5f} ± {errors['scale']:.5f}"


def _bent(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    terms = ", ".join(f"{name} {values[name]:+.3f} ± {errors[name]:.3f}" for name in FIELD if name in errors)
    return f"bent by a smooth field beyond that, px at {FIELD_AT_PX:.0f} px from the middle: {terms}"


def _blurred(values: Mapping[str, float], _: Mapping[str, float]) -> str:
    how = "softer" if values["blur_px2"] > 0 else "sharper"
    return f"{how} than stated, by σ {abs(values['blur_sigma_px']):.2f} px"


_of_shape = partial(Parameter, unit="1", per_px=1.0, power=1, limits=(-0.06, 0.06), most_apart=5e-4)
_of_light = partial(Parameter, inflation=1.3, errors=_SIGNIFICANT_LIGHT)


def _of_field(name: str, power: int) -> Parameter:
    return Parameter(name, "px", FIELD_AT_PX**power, power)


_BENT: Final = ("down_dd_px", "down_dr_px", "down_rr_px", "right_dd_px", "right_dr_px", "right_rr_px")

GROUPS: Final = (
    Group(
        (Parameter("down_px", "px", 1.0), Parameter("right_px", "px", 1.0)),
        _with(
            "they lie {down_px:+.3f} ± {e_down_px:.3f} px down and {right_px:+.3f} ± {e_right_px:.3f} px to the right "
            "of where they are stated"
        ),
    ),
    Group(
        (Parameter("rotation_deg", "deg", math.degrees(1), 1, limits=(-5.0, 5.0), most_apart=0.05), _of_shape("scale")),
        _turned,
    ),
    Group(
        (_of_shape("stretch"), _of_shape("shear")),
        _with("stretched by {stretch:+.5f} ± {e_stretch:.5f} and sheared by {shear:+.5f} ± {e_shear:.5f}"),
    ),
    Group((_of_field("radial_px", 3),), _bent),
    Group(tuple(_of_field(name, 2) for name in _BENT), _bent),
    Group((_of_field("radial5_px", 5),), _bent),
    Group((_of_light("blur_px2", "px²", step=0.05, least=0.02, limits=(-4.0, 16.0), inflation=1.6),), _blurred),
    Group(
        (_of_light("leak", "1", step=0.01, least=0.005, limits=(-0.2, 0.9), most_apart=0.02),),
        _with("closed elements pass {leak:+.3f} ± {e_leak:.3f} more of the light"),
    ),
    Group(
        (_of_light("black", "reading", step=0.01, least=0.01, of_reading=True),),
        _with("the reading without light is {black:+.4g} ± {e_black:.2g}"),
    ),
    Group(
        (_of_light("widening_px", "px", step=0.02, least=0.02, limits=(-MOST_WIDENING_PX, MOST_WIDENING_PX)),),
        _with("open elements reach {widening_px:+.3f} ± {e_widening_px:.3f} px beyond their stated edges"),
    ),
)
"""In the order in which masks are placed, lit, and their edges found."""

PARAMETERS: Final = tuple(one for group in GROUPS for one in group.parameters)
NAMES: Final = tuple(one.name for one in PARAMETERS)
BY_NAME: Final = {one.name: one for one in PARAMETERS}
AFFINE: Final = tuple(name for group in GROUPS[:3] for name in group.names)
LOW: Final = ("radial_px", *_BENT)
HIGHER: Final = ("radial5_px",)
FIELD: Final = (*LOW, *HIGHER)
GEOMETRY: Final = (*AFFINE, *FIELD)
LIGHT: Final = ("blur_px2", "leak", "black")
EDGES: Final = ("widening_px",)


def let_in(pairs: Mapping[str, tuple[float, float]], corner_px: float, reading: float) -> tuple[str, ...]:
    """Return the estimated parameters that are significant and matter; those of one group are let in together.

    An estimate that ended at a limit of its range tells nothing of its group, however small its error is.

    Args:
        pairs: Value and standard error of those that were estimated, by name.
        corner_px: Distance of the picture's corners from its middle.
        reading: Mean reading.
    """

    def is_sure(one: Parameter) -> bool:
        value, error = pairs[one.name]
        return abs(value) >= max(one.errors * error, one.least_at(corner_px, reading)) and error > 0

    asked = [[one for one in group.parameters if one.name in pairs] for group in GROUPS]
    known = [some for some in asked if any(map(is_sure, some)) and all(pairs[p.name][0] not in p.limits for p in some)]
    return tuple(one.name for some in known for one in some)


def in_words(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """Say what the masks' errors are, with standard errors.

    Args:
        values: Of all parameters, by name, and `blur_sigma_px`.
        errors: Standard errors of those that were let in, by name; of these alone something is said.
    """
    said = (group.words(values, errors) for group in GROUPS if any(name in errors for name in group.names))
    return "; ".join(dict.fromkeys(said))
