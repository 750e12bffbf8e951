"""Comparing a calibration bundle with coded shots: how far the masks have moved since, and a correction of the bundle.

A set-up drifts by tenths of a pixel within hours, and every coded shot shows where its masks were
(`gs2ci.reconstruct.registration`). Here: combining the shots' estimates, selecting those that are significant enough
for a bundle, and writing it. Not here: the registration of one shot, the command's output
(`gs2ci.commands.calibrate`, `capture`).
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.crop import middle
from gs2ci.core.errors import StorageError, room_after
from gs2ci.core.records import Shot
from gs2ci.reconstruct.registration.parameters import BY_NAME, GEOMETRY, PARAMETERS, let_in
from gs2ci_calibration.bundle import Bundle, read_bundle, write_bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.refusals import CalibrationError, Reason

if TYPE_CHECKING:
    from gs2ci.reconstruct.registration.misfit import Misfit
    from gs2ci.reconstruct.registration.register import Registered

STEP: Final = "update"
# The black level is not a property of masks.
UNITS: Final = {one.name: one.unit for one in PARAMETERS if one.name != "black"}
# So many of a bundle's stated errors of registration may masks be displaced.
_STATED_ERRORS: Final = 5.0
# Shots whose estimates differ by more than three of their errors on average, and by more than the parameter's
# `most_apart`, saw other masks.
_MOST_CHI2: Final = 9.0
# Allowed difference between the bundle's masks and those of a shot file, which were rounded when stored.
_SAME_MASKS: Final = 2e-3
# After a capture only the middle of this size is registered.
_LOOKED_AT_PX: Final = 256
# A smaller displacement costs a decode only about a tenth of a decibel, whatever error a bundle states.
_LEAST_WARNING_PX: Final = 0.05


@dataclass(frozen=True)
class Update:
    """The correction of a bundle's masks by coded shots.

    Args:
        parameters: All estimated parameters, over all shots, by name (`UNITS`).
        taken: Names of those that were corrected; none if no error of the bundle is significant.
        largest_px: Displacement of the masks' farthest corner by the correction.
        shots: How many shots gave an estimate.
        silent: Files of shots that gave none.
        kept: Where the old bundle lies; None if nothing was changed.
    """

    parameters: Mapping[str, Estimate]
    taken: tuple[str, ...]
    largest_px: float
    shots: int
    silent: tuple[Path, ...]
    kept: Path | None


def update_bundle(path: Path, shots: Sequence[tuple[Path, Shot]]) -> Update:
    """Correct a bundle's masks by their registration in coded shots; the old bundle is kept beside it.

    Args:
        path: The bundle.
        shots: Shots that were taken with it, and the files that they came from.

    Returns:
        The estimates, and which of them were corrected.

    Raises:
        CalibrationError: A shot was coded with other masks, no shot shows the masks' pattern, shots contradict each
            other, or masks are turned, in another order, or more blurred than before: calibrate them again.
        StorageError: The bundle cannot be read or written.
    """
    bundle = read_bundle(path)
    section = bundle.need("masks", STEP)
    answered, silent = [], []
    for file, shot in shots:
        _check_same_masks(file, shot, section)
        found = _registered(shot)
        _check_order(file, found)
        values = values_of(found)
        if values:
            answered.append(values)
        else:
            silent.append(file)
    if not answered:
        raise CalibrationError(
            STEP,
            Reason.NOT_REGISTERED,
            f"the position of the masks cannot be found in any of {len(shots)} shots",
            allowed="a shot in which the pattern of the masks' sum can be found",
            remedy="take shots of a lit scene that are neither dark nor clipped, or run `gs2ci calibrate masks`",
        )
    parameters = {name: _weighted_mean(name, [values[name] for values in answered if name in values]) for name in UNITS}
    known = {name: estimate for name, estimate in parameters.items() if estimate is not None}
    size: tuple[int, int] = section.array("masks").shape[1:]
    pairs = {name: (float(estimate), float(estimate.error)) for name, estimate in known.items()}
    taken = let_in(pairs, float(np.hypot(*size)) / 2, 1.0)
    if not taken:
        return Update(known, (), 0.0, len(answered), tuple(silent), None)
    misfit = _misfit({name: float(known[name]) for name in taken})
    moved = _moved(section, misfit, {name: known[name] for name in taken}, [file for file, _ in shots])
    kept = _keep(path)
    write_bundle(path, replace(bundle.with_section(moved), path=path))
    largest = float(np.linalg.norm(misfit.displacement_px(size), axis=1).max())
    return Update(known, taken, largest, len(answered), tuple(silent), kept)


@dataclass(frozen=True)
class MasksMoved:
    """Displacement of a shot's masks from their positions in the bundle.

    Args:
        largest_px: Largest displacement among the middle and the corners of the registered region; 0 if none was found.
        error_px: Standard error of the shift.
        allowed_px: The limit by the registration error that the bundle states.
        otherwise: In words, how they lie or follow each other otherwise than in the bundle; the displacement is then
            that of masks which do so. Empty if they do not.
    """

    largest_px: float
    error_px: float
    allowed_px: float
    otherwise: str = ""

    @property
    def too_far(self) -> bool:
        """Get whether they have moved by more than the bundle's stated error allows."""
        return self.largest_px > self.allowed_px


def can_look() -> bool:
    """Return whether this computer can register a shot, which needs torch; a bench's computer need not have it."""
    return find_spec("torch") is not None


def how_far_moved(shot: Shot, bundle: Bundle) -> MasksMoved | None:
    """Estimate from the middle of a shot how far its masks are displaced; None if the shot does not show it.

    Args:
        shot: A shot taken with the bundle's masks.
        bundle: The bundle.
    """
    part = middle(shot, (min(shot.size[0], _LOOKED_AT_PX), min(shot.size[1], _LOOKED_AT_PX)))
    found = _registered(part)
    values = values_of(found)
    if "down_px" not in values:
        return None
    corners = np.linalg.norm(found.misfit.displacement_px(part.size), axis=1)
    error = float(np.hypot(values["down_px"][1], values["right_px"][1]))
    said = [f"are {found.orientation}"] * (found.orientation != "as given")
    said += [f"begin with mask {found.first_mask + 1}"] * (found.first_mask > 0)
    return MasksMoved(float(corners.max()), error, _stated_error_px(bundle), " and ".join(said))


def values_of(found: "Registered") -> dict[str, tuple[float, float]]:
    """Return one shot's estimate of each parameter with its standard error; parameters without one are left out.

    How the masks pass light counts only where held-out pixels confirmed it: of masks that are soft, as measured ones
    are, it is mistaken for a sharpness (-0.23 px² where nothing had changed), however small its own error.
    """
    taken = found.misfit.values()
    tried = {name: pair for name, pair in found.tried.items() if name in GEOMETRY}
    values = {**tried, **{name: (taken[name], error) for name, error in found.errors.items()}}
    return {name: pair for name, pair in values.items() if name in UNITS and pair[1] > 0 and np.isfinite(pair).all()}


def _registered(shot: Shot) -> "Registered":
    from gs2ci.reconstruct.registration.register import register  # noqa: PLC0415  as above

    return register(shot)


def _stated_error_px(bundle: Bundle) -> float:
    """Return how far masks may be displaced by the registration error that a bundle states."""
    section = bundle.sections.get("registration")
    if section is None or "sensor_from_modulator" not in section.estimates:
        return _LEAST_WARNING_PX
    affine = section.estimates["sensor_from_modulator"]
    errors = np.broadcast_to(affine.standard_error, affine.value.shape)
    return max(_LEAST_WARNING_PX, float(_STATED_ERRORS * np.linalg.norm(errors[:, 2])))


def _check_same_masks(file: Path, shot: Shot, section: Section) -> None:
    stated = np.where(section.known, np.clip(section.array("masks"), 0, 1), 0)
    same = shot.masks.shape == stated.shape
    # Exposures of one capture begin with different masks.
    turned = (np.roll(stated, -first, axis=0) for first in range(len(stated)))
    if not same or not any(float(np.abs(shot.masks - masks).max()) <= _SAME_MASKS for masks in turned):
        raise CalibrationError(
            STEP,
            Reason.DOES_NOT_FIT,
            f"{file} was coded with other masks than the bundle's",
            allowed="shots that were taken with this bundle",
            remedy="`gs2ci capture --calibration BUNDLE` takes them; after an update, take new ones",
        )


def _check_order(file: Path, found: "Registered") -> None:
    if found.orientation != "as given":
        raise CalibrationError(
            STEP,
            Reason.FLIPPED,
            f"in {file} the masks are {found.orientation} compared with the bundle",
            remedy="check what was turned on the bench, and run `gs2ci calibrate registration` and `masks`",
        )
    if found.first_mask:
        raise CalibrationError(
            STEP,
            Reason.WRONG_ORDER,
            f"in {file} mask {found.first_mask + 1} was shown first",
            remedy="check the trigger of the sensor, and run `gs2ci calibrate masks`",
        )


def _weighted_mean(name: str, values: list[tuple[float, float]]) -> Estimate | None:
    """Return the weighted mean of the shots' estimates; its error is that from their scatter if that is larger.

    Raises:
        CalibrationError: The estimates contradict each other.
    """
    if not values:
        return None
    found, errors = np.array(values).T
    weights = 1 / errors**2
    mean = float((weights * found).sum() / weights.sum())
    chi2 = float((weights * (found - mean) ** 2).sum()) / max(len(found) - 1, 1)
    apart = float(np.ptp(found))
    most = BY_NAME[name].most_apart
    if chi2 > _MOST_CHI2 and apart > most:
        raise CalibrationError(
            STEP,
            Reason.BAD_FIT,
            f"the shots contradict each other: {name} from {found.min():.3g} to {found.max():.3g} {UNITS[name]}",
            allowed=f"{most:g} {UNITS[name]} apart, or three of their standard errors",
            remedy="the masks moved between the shots: take new ones in quick succession, and update with those",
        )
    return Estimate(mean, np.sqrt(max(chi2, 1.0) / weights.sum()), UNITS[name])


def _misfit(values: Mapping[str, float]) -> "Misfit":
    from gs2ci.reconstruct.registration.misfit import Misfit  # noqa: PLC0415  a bench's computer need not have torch

    return Misfit(**values)


def _moved(section: Section, misfit: "Misfit", taken: Mapping[str, Estimate], files: Sequence[Path]) -> Section:
    """Return the section with its masks displaced; pixels without a known transmission are marked invalid."""
    before = section.estimates["masks"]
    masks = _transmissions(before.value, misfit)
    # To a mask's variance is added the change by one standard error of each parameter.
    more = 0.0
    for name, estimate in taken.items():
        off = _misfit({**{one: float(taken[one]) for one in taken}, name: float(estimate) + estimate.error})
        more += float(np.mean((_transmissions(before.value, off) - masks) ** 2, dtype=np.float64))
    error = np.sqrt(before.standard_error.astype(np.float64) ** 2 + more)
    size: tuple[int, int] = masks.shape[1:]
    known = misfit.known(size) & (misfit.sample(section.known[None].astype(np.float64))[0] > 0.99)
    listed = "; ".join(f"{name} {estimate}" for name, estimate in taken.items())
    return replace(
        section,
        estimates={**section.estimates, "masks": Estimate(masks, error, before.unit)},
        arrays={**section.arrays, "valid": known.astype(np.uint8)},
        facts={**section.facts, "updated_from": [str(file) for file in files]},
        notes=(*section.notes, f"displaced as estimated from coded shots: {listed}"),
        measured_utc=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _transmissions(masks: np.ndarray, misfit: "Misfit") -> F32:
    moved: F64 = misfit.of_masks(np.clip(masks, 0, 1).astype(np.float64))
    return moved.astype(np.float32)


def _keep(path: Path) -> Path:
    """Copy a bundle beside itself, with the time of its replacement in the name.

    Raises:
        StorageError: It cannot be copied; nothing was changed.
    """
    name = path.name.removesuffix(".h5")
    until = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    kept, count = path.with_name(f"{name}.until-{until}.h5"), 1
    while kept.exists():
        count += 1
        kept = path.with_name(f"{name}.until-{until}-{count}.h5")
    try:
        shutil.copy2(path, kept)
    except OSError as error:
        raise StorageError(
            f"{kept}: the old bundle cannot be kept: {error}", remedy=f"{room_after(error)}, check the folder"
        ) from error
    return kept
