"""What the numbers themselves show of masks and readings, before anything is decoded.

Here: the order in which it is found out: where the masks' pattern shows, whether they are inverted, which of them were
shown, whether readings are in proportion to light. Each is corrected if the numbers leave no doubt, and said. Not here:
the questions themselves (`pattern`, `shown`, `light`, `overflow`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign import agreement, light
from gs2ci.core.foreign.agreement import CodingConvention
from gs2ci.core.foreign.colours import COLOURS
from gs2ci.core.foreign.container import Array
from gs2ci.core.foreign.curves import CurveName, full_scale
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.foreign.pattern import PatternTrace
from gs2ci.core.foreign.scale import OPEN
from gs2ci.core.foreign.shown import Traces, traces
from gs2ci.core.linearity import Growth, lattices

# A correlation this far below zero: the masks are open where the readings say closed.
_INVERTED: Final = -0.3
# Light that no mask accounts for, as a share; and the share of it that the fine pattern then is unexplained at least:
# 0.75 to 1.1 with masks missing, up to 0.4 with a black level, a leak or softer masks (mosaics most).
_UNACCOUNTED: Final = 0.05
_UNACCOUNTED_CLIPPED: Final = 0.08
_SIGMAS: Final = 4.0
_PATTERN_OF_IT: Final = 0.5
# Readings that grow faster than masks open by more than this; the masks' closed level lies below this quantile.
_STEEP: Final = 0.08
_CLOSED: Final = 0.3
_HALVINGS: Final = 8
_MOST_ASKED: Final = 8
_LEAST_BACKGROUND: Final = 0.01
# What masks that were divided at each pixel have in common everywhere, up to the digits of float32.
_THE_SAME: Final = 1e-3


_PLANES: Final = "is each bit a mask, as in the pictures of a modulator (np.unpackbits)"


@dataclass(frozen=True)
class SettledReadings:
    """Masks and readings as the numbers show them.

    Args:
        readings: Above the offset, in proportion to light as far as can be told, [K, H, W, C].
        coding: The masks that were shown.
        traced: Where their pattern shows; None where the measurement cannot be asked.
        shown: Indices of those masks among the given ones.
        given: How many were given.
        undone: What was undone of the readings.
        curved: Whether they still are not in proportion to light.
    """

    readings: F64
    coding: CodingConvention
    traced: PatternTrace | None
    shown: tuple[int, ...]
    given: int
    undone: CurveName | None
    curved: bool


@dataclass(frozen=True)
class _Settling:
    measurement: Array
    masks: Array
    options: ImportOptions
    is_mosaic: bool
    has_dark: bool
    guesses: list[str]

    def may_be_planes(self, masks: int) -> bool:
        """Tell whether so few masks are of bytes, each of whose bits may be one."""
        values = self.masks.values
        return masks <= COLOURS and values.dtype == np.uint8 and len(np.unique(values)) > 2

    @property
    def saturation(self) -> float | None:
        said = self.options.saturation
        return said if not said else said - (self.options.offset or 0.0)

    def pattern(self, readings: F64, coding: CodingConvention) -> PatternTrace | None:
        """Find where the masks' pattern shows, with a mosaic's colours brought to one level."""
        image = readings[0].mean(axis=2)
        if self.is_mosaic:
            level = max(float(np.abs(image).mean()), 1e-300)
            for plane in lattices(image, is_mosaic=True):
                plane[...] = plane * (level / max(float(plane.mean()), 1e-3 * level))
        return agreement.find_pattern(image, coding.multiplicity)

    def undivided(self, readings: F64, coding: CodingConvention) -> CodingConvention:
        """Take masks that were divided at each pixel by their sum or norm as they were, if readings were not, too."""
        masks = coding.masks.astype(np.float64)
        total, squares = masks.sum(axis=0), (masks**2).sum(axis=0)
        opened = total > 0
        # Of masks that are open or closed this counts the open ones, by whatever a pixel's were divided.
        count = np.where(opened, total**2 / np.maximum(squares, 1e-300), 0)
        for power, same, words in ((1.0, total, "sum"), (0.5, squares, "norm (the root of the sum of their squares)")):
            if not opened.any() or np.ptp(same[opened]) > _THE_SAME * same.max() or np.ptp(count[opened]) < _THE_SAME:
                continue
            before = (masks * count**power).astype(np.float32)
            undone = CodingConvention(np.asarray(before / before.max(), np.float32), coding.weights)
            found = self.question(readings, undone, self.pattern(readings, undone)).grow()
            # Readings that were divided, too, have the slope 1 - power.
            if found is not None and found.slope > 1 - power / 2 + _SIGMAS * found.slope_error:
                self.guesses.append(
                    f"WARNING: {self.masks.where}: the masks were divided at each pixel by their {words}, and the "
                    f"readings were not: they grow with the masks as they were before (slope {found.slope:.2f}); those "
                    "are taken"
                )
                return undone
        return coding

    def upright(self, readings: F64, coding: CodingConvention) -> tuple[CodingConvention, PatternTrace | None]:
        """Find the masks' pattern, and take the masks the other way round if it shows where they are closed."""
        traced = self.pattern(readings, coding)
        if traced is None or traced.upright > _INVERTED:
            return coding, traced
        self.check_not_negative(readings, coding)
        self.guesses.append(
            f"WARNING: {self.masks.where}: the masks are inverted: their pattern shows where they are closed "
            f"(correlation {traced.upright:.2f}); taken the other way round, 1 - mask"
        )
        coding = CodingConvention(np.asarray(1 - coding.masks, np.float32), coding.weights)
        return coding, self.pattern(readings, coding)

    def check_not_negative(self, readings: F64, coding: CodingConvention) -> None:
        """Refuse a picture whose white is zero; its masks look inverted.

        Raises:
            InputError: Its negative grows as the masks open, and it does not as they close.
        """
        full = full_scale(self.measurement.values) - (self.options.offset or 0.0)
        closed = CodingConvention(np.asarray(1 - coding.masks, np.float32), coding.weights)
        as_given, turned = (
            self.question(readings, closed, None).grow(),
            self.question(full - readings, coding, None).grow(),
        )
        if as_given is None or turned is None or as_given.slope > 1 - 2 * _STEEP or abs(turned.slope - 1) > _STEEP:
            return
        raise InputError(
            f"{self.measurement.where}: a negative: readings fall as the masks open, and {full:.6g} - reading grows "
            f"with them in proportion (slope {turned.slope:.2f})",
            allowed="readings that grow with the light",
            remedy=f"save {full:.6g} - reading",
        )

    def without_frames(
        self, readings: F64, coding: CodingConvention, traced: PatternTrace | None, shown: tuple[int, ...]
    ) -> tuple[CodingConvention, tuple[int, ...]]:
        """Leave out white frames among the masks, and dark ones with them, if readings grow as the others open."""
        white, dark = coding.masks.min(axis=(1, 2)) > OPEN, coding.masks.max(axis=(1, 2)) == 0
        kept = np.flatnonzero(~(white | dark))
        if not white.any() or not len(kept) or self.options.views is not None:
            return coding, shown
        others = CodingConvention(coding.masks[kept], coding.weights[kept])
        before, after = (self.question(readings, one, traced).grow() for one in (coding, others))
        if before is None or after is None or before.is_biased or abs(after.slope - 1) > _STEEP:
            return coding, shown
        if before.slope < 1 + _STEEP + _SIGMAS * before.slope_error:
            return coding, shown
        self.guesses.append(
            f"WARNING: {self.masks.where}: masks {_listed(np.flatnonzero(white | dark))} are white and dark frames "
            f"that were not shown (readings grow {before.slope:.2f} times as fast as the masks open with them, "
            f"{after.slope:.2f} times without): they are left out; say --views {len(coding.masks)} to keep all"
        )
        return others, tuple(shown[index] for index in kept)

    def check_alike(self, readings: F64, coding: CodingConvention, first: Traces, traced: PatternTrace | None) -> None:
        """Refuse a later measurement of the file, or a colour of the first, that shows masks which the first does not.

        Raises:
            InputError: There is one; three measurements under masks of their own look like three colours.
        """
        others = [(f"measurement {k}", readings[k:]) for k in range(1, min(len(readings), _MOST_ASKED))]
        others += [
            (f"plane {c}", readings[:, :, :, c : c + 1])
            for c in range(readings.shape[3])
            if c != readings.shape[3] // 2
        ]
        for name, plane in others:
            other = self.traces(plane, coding, traced)
            if other is not None and (other.shown & ~first.shown).any():
                listed = [_listed(np.flatnonzero(one.shown)) for one in (first, other)]
                raise InputError(
                    f"{self.masks.where}: one measurement shows masks {listed[0]}, {name} masks {listed[1]}: masks of "
                    "their own",
                    allowed="measurements that share their masks; or [K, H, W] with masks [K, N, H, W]",
                    remedy="save them as [K, N, H, W], or import each with its masks",
                )

    def traces(self, readings: F64, coding: CodingConvention, traced: PatternTrace | None) -> Traces | None:
        """Find the trace of each mask."""
        image = readings[0, :, :, readings.shape[3] // 2]
        masks = coding.masks if traced is None else traced.placed(coding.masks)
        weighted = masks * coding.weights[:, None, None]
        clip = light.clip_of(image, self.saturation)
        return traces(image, weighted, clip=clip, is_mosaic=self.is_mosaic)

    def choose(self, coding: CodingConvention, found: Traces | None) -> tuple[CodingConvention, tuple[int, ...]]:
        """Keep the masks that were shown."""
        every = tuple(range(len(coding.masks)))
        if found is None or found.shown.all():
            return coding, every
        absent = np.flatnonzero(~found.shown)
        told = (
            f"WARNING: {self.masks.where}: of {len(every)} masks {_listed(absent)} left no trace in the readings "
            f"({np.abs(found.shares[absent]).max():.2f} ± {found.errors[absent].max():.2f} or less of the others')"
        )
        if self.options.views is not None:
            self.guesses.append(f"{told}: were they shown? Taken as --views says")
            return coding, every
        shown = tuple(int(index) for index in np.flatnonzero(found.shown))
        self.guesses.append(f"{told}: they were not shown and are left out; say --views {len(every)} to keep all")
        return CodingConvention(coding.masks[list(shown)], coding.weights[list(shown)]), shown

    def question(self, readings: F64, coding: CodingConvention, traced: PatternTrace | None) -> light.LightQuestion:
        """Return the question whether readings are in proportion to light."""
        opened = coding.multiplicity if traced is None else traced.moved(coding.multiplicity)
        return light.LightQuestion(self.measurement, readings, opened, self.saturation, self.is_mosaic)

    def without_background(
        self, readings: F64, coding: CodingConvention, traced: PatternTrace | None
    ) -> CodingConvention:
        """Take a background from masks that lie on one, where an offset was taken from the readings alone.

        A camera that records masks records its background with them. Once the readings have lost theirs, they grow
        faster than such masks open; without it, both grow alike. Masks that close entirely have none: then the offset
        is too large.
        """
        if not self.options.offset and not self.has_dark:
            return coding

        def lifted(level: float) -> CodingConvention:
            masks = np.clip((coding.masks - level) / (1 - level), 0, 1)
            return CodingConvention(masks.astype(np.float32), coding.weights)

        def slope(level: float) -> Growth | None:
            return self.question(readings, lifted(level), traced).grow()

        found = slope(0.0)
        if found is None or found.is_biased or found.slope < 1 + _STEEP + _SIGMAS * found.slope_error:
            return coding
        low, high = 0.0, float(np.quantile(coding.masks, _CLOSED))
        for _ in range(_HALVINGS):
            level = (low + high) / 2
            there = slope(level)
            low, high = (level, high) if there is not None and there.slope > 1 else (low, level)
        last = slope(high)
        if last is None or abs(last.slope - 1) > _STEEP or high < _LEAST_BACKGROUND:
            self.guesses.append(
                f"WARNING: {self.measurement.where}: above this offset readings grow {found.slope:.2f} times as fast "
                "as the masks open, and masks that do not close do not explain it: is the offset too large?"
            )
            return coding
        self.guesses.append(
            f"WARNING: {self.masks.where}: the masks lie on a background of {high:.3g} of a fully open one, as masks "
            f"do that a camera recorded with its offset; it was subtracted from them too (readings grew "
            f"{found.slope:.2f} times as fast as the masks opened, now {last.slope:.2f})"
        )
        return lifted(high)

    def report_traces(self, found: Traces | None, growth: Growth | None, clipped: bool) -> bool:
        """Say so if masks are missing, or were shown twice; return whether some are missing."""
        if found is None:
            return False
        if found.twice.any():
            twice = np.flatnonzero(found.twice)
            self.guesses.append(
                f"WARNING: {self.masks.where}: masks {_listed(twice)} left {found.shares[twice].mean():.1f} times the "
                "trace of the others: were they shown twice, or longer? Then give their weights under the key 'weights'"
            )
        if growth is None or growth.is_biased:
            return False
        left = 1 - growth.slope
        least = _UNACCOUNTED_CLIPPED if clipped else _UNACCOUNTED
        lacking = left > least + _SIGMAS * growth.slope_error and found.unexplained > _PATTERN_OF_IT * left
        if lacking:
            masks = int(found.shown.sum())
            planes = f"; or {_PLANES}?" if self.may_be_planes(masks) else ""
            self.guesses.append(
                f"WARNING: {self.measurement.where}: {left:.0%} of the light and {found.unexplained:.0%} of the fine "
                f"pattern are explained neither by these {masks} masks nor by texture: were more masks shown than the "
                f"file holds (about {max(1, round(masks * left / growth.slope))} more)? A leak, a black level "
                f"(--offset) or softer masks explain light, but no pattern{planes}"
            )
        return lacking


def settle(
    measurement: Array,
    masks: Array,
    options: ImportOptions,
    coding: CodingConvention,
    readings: F64,
    *,
    is_mosaic: bool,
    has_dark: bool = False,
    guesses: list[str],
) -> SettledReadings:
    """Find out what the numbers show of masks and readings.

    Args:
        measurement: As stored, for its type and for messages.
        masks: For messages.
        options: What the user fixed.
        coding: Masks as given, scaled.
        readings: Above the offset, [K, H, W, C].
        is_mosaic: Whether a single channel is known to be a mosaic; one that looks like it is recognised.
        has_dark: Whether a dark frame was subtracted from the readings.
        guesses: Sentences are added here.

    Raises:
        InputError: A negative; or several exposures under masks of their own.
    """
    if readings.shape[3] == 1 and not is_mosaic:
        is_mosaic = agreement.mosaic_of(readings[0, :, :, 0], coding) is not None
    work = _Settling(measurement, masks, options, is_mosaic and readings.shape[3] == 1, has_dark, guesses)
    given = len(coding.masks)
    coding, traced = work.upright(readings, work.undivided(readings, coding))
    found = work.traces(readings, coding, traced)
    if found is not None and not found.shown.all():
        work.check_alike(readings, coding, found, traced)
    coding, shown = work.choose(coding, found)
    coding, shown = work.without_frames(readings, coding, traced, shown)
    if len(shown) < given:
        traced = work.pattern(readings, coding)
    coding = work.without_background(readings, coding, traced)
    question = work.question(readings, coding, traced)
    examined = light.examine(question, options.curve, guesses)
    if examined.undone is not None:
        traced = work.pattern(examined.readings, coding)
    lacking = False
    if examined.curved and work.may_be_planes(given):
        guesses.append(f"WARNING: {masks.where}: {given} masks of bytes: {_PLANES}?")
    if examined.undone is None and not examined.curved:
        clipped = bool(np.isfinite(light.clip_of(question.image, work.saturation)))
        lacking = work.report_traces(found, examined.growth, clipped)
    agreement.report_pattern(traced, measurement, masks, guesses)
    # Masks that are missing light pixels that the others close, and those of another measurement close none.
    if options.offset is None and not lacking and (traced is None or traced.shows):
        opened = coding.multiplicity if traced is None else traced.moved(coding.multiplicity)
        agreement.check_closed_pixels(examined.readings[0], opened, guesses)
    return SettledReadings(examined.readings, coding, traced, shown, given, examined.undone, examined.curved)


def _listed(indices: np.ndarray[tuple[int], np.dtype[np.intp]]) -> str:
    """Write down indices, runs of them as first to last."""
    runs: list[list[int]] = []
    for index in indices.tolist():
        if runs and index == runs[-1][-1] + 1:
            runs[-1].append(index)
        else:
            runs.append([index])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)
