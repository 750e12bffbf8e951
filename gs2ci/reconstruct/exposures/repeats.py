"""Repeats: exposures of one path, decoded together as equations for the same views.

    views of one predict the readings of another ─► groups ─► decoded together ─► held-out pixels decide ─► path, depth

Whether an exposure repeats another is read from the readings, whatever a stage says. Views decoded from one reading
alone predict the reading of a repeat as well as they predict their own held-out pixels: no decode has seen either. A
path that is off by a fraction of a pixel displaces all views alike, which a reading, their sum, shows.

Here: which exposures are repeats, their decode, and what follows for path and depth. Not here: the decoder (`decode`),
the views that are delivered (`fusion`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, rms_of
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.progress import Progress, said
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.decode.gap_tv import decode_weighing
from gs2ci.reconstruct.exposures.observing import ObservedExposure, held
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.combining.refinement import Refinement
from gs2ci.reconstruct.geometry.prior import GeometryPrior, Request, find_geometry
from gs2ci.reconstruct.measurement.brightness import Brightness
from gs2ci.reconstruct.measurement.faulty import fill_holes
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.observe import as_shown
from gs2ci.reconstruct.settings import Settings

# A repeat is predicted with at most so many times the residual at held-out pixels, and so many standard errors of it.
_MOST_MISFIT: Final = 1.1
_ERRORS: Final = 2.0
# Views of repeats seem displaced by no more px: at 5 % noise decodes of the same views did by up to 0.2, those of paths
# that displaced what lies in the middle by 0.25 px by 0.3 to 0.5.
_APART_PX: Final = 0.25
# Exposures whose light differs by less than this share count as equally bright: decodes tell it to a few thousandths.
_ALIKE: Final = 0.01
# Light of repeats does not differ by more.
_MOST_BRIGHT: Final = 10.0


@dataclass(frozen=True, eq=False)
class CommonDecode:
    """Repeats decoded together.

    Args:
        views: [N, H, W, C].
        noise: Power of the noise that was weighed, in each reading, [H, W, C].
        heldout_rms: What the views leave at the held-out pixels of each.
    """

    views: F32
    noise: F32
    heldout_rms: tuple[float, ...]


def decoded_together(
    observed: Sequence[ObservedExposure], settings: Settings, prior: GeometryPrior, progress: Progress
) -> tuple[list[ObservedExposure], Findings]:
    """Find repeats, decode them together, and find one path and depth for each group of them.

    Exposures that repeat none are returned as they are. Of a group, those stay whose held-out pixels the common decode
    explains better than their own.

    Args:
        observed: All exposures, each observed alone.
        settings: Of every stage.
        prior: Where geometry comes from.
        progress: Receives what people are told.

    Returns:
        The exposures in the order given, and what there is to say.
    """
    if LeftOut.REPEATS_DECODED_TOGETHER in settings.left_out:
        return list(observed), ()
    found, notes = list(observed), []
    at = {one.number: place for place, one in enumerate(observed)}
    for group in groups(observed):
        kept, decoded = _kept(group, settings)
        if decoded is None:
            continue
        for one in _with_one_geometry(kept, decoded, settings, prior, progress):
            found[at[one.number]] = one
        first, *others = (one.name for one in kept)
        alike = all(np.array_equal(one.given.masks, kept[0].given.masks) for one in kept)
        code = Code.EXPOSURES_REPEAT_MASKS if alike else Code.EXPOSURES_REPEAT
        notes.append(finding(code, name=first, others=", ".join(others)))
    return found, said(notes, progress)


def groups(observed: Sequence[ObservedExposure]) -> list[list[ObservedExposure]]:
    """Return the exposures that seem to repeat each other, with the brightness of the first of each group.

    The weights of the masks of those that are brighter are corrected, so that all groups' views are of one brightness.
    Groups of one are left out.
    """
    # First looks are held, since each is compared with those of all groups: to read it from a disk takes longer.
    found: list[tuple[FirstLook, list[ObservedExposure]]] = []
    for one in observed:
        other = one.observed.first
        for first, group in found:
            brightness = repeats(first, other)
            if brightness is not None:
                group.append(_relit(one, brightness))
                break
        else:
            found.append((other, [one]))
    return [group for _, group in found if len(group) > 1]


def repeats(first: FirstLook, other: FirstLook) -> float | None:
    """Tell whether another exposure shows the same views: how many times as bright they are in it; None if it does not.

    Without held-out pixels nothing can be told.
    """
    shots = first.holdout.shot, other.holdout.shot
    if len({(shot.views, shot.size, shot.channels, shot.cfa) for shot in shots}) > 1:
        return None
    own = [look.holdout.residual_rms(look.decoded) for look in (first, other)]
    predicted = [_Predicted.of(views, look) for views, look in ((first.decoded, other), (other.decoded, first))]
    if not own[0] or not own[1] or not all(1 / _MOST_BRIGHT < one.light < _MOST_BRIGHT for one in predicted):
        return None
    # A noisier reading is predicted worse by the views of the other, and predicts the other's better than its own.
    ratio = math.sqrt(predicted[0].misfit * predicted[1].misfit / (own[0] * own[1]))
    fewest = min(int(look.holdout.pixels.sum()) for look in (first, other))
    if ratio > _MOST_MISFIT + _ERRORS / math.sqrt(2 * fewest):
        return None
    apart = 0.5 * (predicted[0].displacement_px() - predicted[1].displacement_px())
    # The largest of a view.
    if np.linalg.norm(np.abs(apart).sum(axis=1)) > _APART_PX:
        return None
    brightness = math.sqrt(predicted[0].light / predicted[1].light)
    return 1.0 if abs(brightness - 1) < _ALIKE else brightness


@dataclass(frozen=True, eq=False)
class _Predicted:
    """The readings of a measurement as views decoded from another one predict them.

    Args:
        views: [N, H, W, C].
        holdout: The measurement.
        light: How many times as bright its readings are; 0 if the views are dark.
        left: What the views, as bright, leave of its usable readings, [P, C], in the views' brightness.
    """

    views: F32
    holdout: Holdout
    light: float
    left: F64

    @classmethod
    def of(cls, views: F32, look: FirstLook) -> "_Predicted":
        usable = look.holdout.shot.usable
        predicted = look.holdout.coded(views)[usable].astype(np.float64)
        read, whole = look.holdout.shot.measurement[usable], float(predicted.sum())
        light = float(read.sum(dtype=np.float64)) / whole if whole > 0 else 0.0
        return cls(views, look.holdout, light, read / light - predicted if light > 0 else predicted)

    @property
    def misfit(self) -> float:
        """Get the root mean square of what is left, in the measurement's brightness."""
        return self.light * rms_of(self.left)

    def displacement_px(self) -> F64:
        """Return by how much the views seem displaced there, to first order: as a mean and by time, [2, 2] px."""
        usable = self.holdout.shot.usable
        times = np.linspace(-1, 1, len(self.views), dtype=np.float32)[:, None, None, None]
        slopes = [np.gradient(self.views, axis=axis).astype(np.float32) for axis in (2, 1)]
        moved = [
            self.holdout.coded(slope * by)[usable].ravel() for slope in slopes for by in (np.ones_like(times), times)
        ]
        found = np.linalg.lstsq(np.stack(moved, axis=1).astype(np.float64), self.left.ravel(), rcond=None)[0]
        return np.asarray(found, np.float64).reshape(2, 2)


def decode(looks: Sequence[FirstLook], settings: Settings) -> CommonDecode:
    """Decode repeats together by GAP-TV; the noise of their readings is sought from the residual of single decodes on.

    Args:
        looks: Of each, in one brightness, with held-out pixels.
        settings: Of the decoders.
    """
    holdouts = [look.holdout for look in looks]
    shape = holdouts[0].shot.measurement.shape
    power = float(np.mean([(look.holdout.residual_rms(look.decoded) or 0.0) ** 2 for look in looks]))
    views, noise = decode_weighing(holdouts, settings.decode, np.full(shape, power, np.float32))
    return CommonDecode(views, noise, tuple(one.residual_rms(views) or math.inf for one in holdouts))


def _kept(group: Sequence[ObservedExposure], settings: Settings) -> tuple[list[ObservedExposure], CommonDecode | None]:
    """Leave out those whose own decode explains their held-out pixels better, the worst first; None if one is left."""
    kept = list(group)
    while len(kept) > 1:
        looks = [one.observed.first for one in kept]
        decoded = decode(looks, settings)
        own = [look.holdout.residual_rms(look.decoded) or 0.0 for look in looks]
        worse = [after / before for after, before in zip(decoded.heldout_rms, own, strict=True)]
        if max(worse) < 1:
            return kept, decoded
        del kept[int(np.argmax(worse))]
    return kept, None


def _relit(one: ObservedExposure, brightness: float) -> ObservedExposure:
    """Return an exposure whose masks weigh by so much more, and whose delivered views are so much brighter."""
    if brightness == 1.0:
        return one
    observed = one.observed
    first, fits = observed.first, observed.fits
    shot = first.holdout.shot
    known = np.ones(shot.views) if first.brightness.factors is None else first.brightness.factors
    holdout = Holdout(replace(shot, weights=(shot.weights * brightness).astype(np.float32)), first.holdout.pixels)
    lit = replace(first.brightness, factors=known * brightness)
    score = as_shown(fits.score, Brightness(None, np.full(shot.views, brightness), lit.as_seen))
    first = replace(first, holdout=holdout, decoded=(first.decoded / brightness).astype(np.float32), brightness=lit)
    return replace(one, again=held(replace(observed, first=first, fits=replace(fits, score=score))))


def _with_one_geometry(
    group: Sequence[ObservedExposure],
    decoded: CommonDecode,
    settings: Settings,
    prior: GeometryPrior,
    progress: Progress,
) -> list[ObservedExposure]:
    """Return repeats with their common decode, and the path and depth that it shows."""
    leader = group[0].observed
    first, fits = leader.first, leader.fits
    request = Request.of(first.holdout.seen, decoded.views, settings.geometry, fits.lens)
    geometry, order = find_geometry(prior, request, progress), leader.order
    if geometry.has_path or not first.geometry.has_path:
        look, order = fits.order_of(replace(first, decoded=decoded.views, geometry=geometry))
        geometry = look.geometry
    else:
        geometry = first.geometry
    alone = [one.observed for one in group]
    holdouts = [one.first.holdout for one in alone]
    found = []
    for one, own in zip(group, alone, strict=True):
        others = [other for other in holdouts if other is not own.first.holdout]
        holdout = Holdout(own.first.holdout.shot, own.first.holdout.pixels, others)
        look = replace(
            own.first,
            holdout=holdout,
            decoded=decoded.views,
            geometry=geometry,
            decoder="gap-tv",
            sigma=None,
            brief_rms=None,
            noise=decoded.noise,
        )
        of_fits = replace(
            own.fits,
            holdout=holdout,
            fitted=Holdout(fill_holes(holdout.shot, decoded.views), holdout.pixels),
            refine=Refinement(holdout, settings.residual),
        )
        observed = replace(own, first=look, order=order, fits=of_fits)
        found.append(replace(one, again=held(observed), repeats=group[0].number))
    return found
