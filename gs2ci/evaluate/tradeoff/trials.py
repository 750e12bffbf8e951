"""The trials on a shot: the ladder of presets, and the standard with one setting changed at a time.

Here: `TRIALS`, their expected times, and the row of figures of each trial. Not here: the comparison of rows
(`front.py`). Rows hold plain values, so that they can be stored.

Every trial is judged by pixels of the measurement that no stage after registration saw: two percent, drawn in addition
to those that the reconstruction holds out for itself. So trials can be compared with and without a truth, and with and
without held-out pixels of their own. Registration comes first because it corrects the masks and readings by which views
are judged; it estimates a few numbers from the whole measurement, so that two percent of it hardly matter. Trials that
register alike are judged by the same pixels.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, get_args

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view, ssim_per_view
from gs2ci.evaluate.tradeoff.shrinking import enlarged, shrunk, touched
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.choices import FirstLookName
from gs2ci.reconstruct.decode.by_name import decode_by_name
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.named import PRESETS, rescheduled
from gs2ci.reconstruct.registration.register import Registered, register
from gs2ci.reconstruct.settings import Settings

BASELINE: Final = "standard"
JUDGED_SHARE: Final = 0.02
# Makes the judging pixels differ from those that a run of the same seed holds out itself.
JUDGES: Final = 0x7D0FF
RMS_FLOOR: Final = 1e-5  # of full scale: 100 dB, as for images


@dataclass(frozen=True)
class TradeoffTrial:
    """One way to treat a shot.

    Args:
        name: Name in tables.
        knob: Which setting differs from the standard; "preset" for the ladder.
        settings: Settings of every stage.
        fits: Whether a scene is fitted; otherwise the shot is only decoded.
        shrink: The resolution is divided by this.
        exposures: So many are reconstructed together (`exposures`).
    """

    name: str
    knob: str
    settings: Settings
    fits: bool = True
    shrink: int = 1
    exposures: int = 1


def _trials() -> dict[str, TradeoffTrial]:
    """Make the trials: the presets, and the standard with one setting changed, named by where it lies.

    Of the rasteriser, 1e-4 of the light and lists for four iterations are the standard; of windows, a narrower and a
    wider one each are tried.
    """
    base = PRESETS[BASELINE]
    found = [TradeoffTrial("decode", "preset", base, fits=False)]
    found += [TradeoffTrial(name, "preset", settings) for name, settings in PRESETS.items()]
    found.append(TradeoffTrial("half the resolution", "resolution", base, shrink=2))
    schedules = [rescheduled(base.fit, iterations) for iterations in (50, 100, 200, 800)]
    looks = [name for name in get_args(FirstLookName) if name != base.first_look]
    changes: tuple[tuple[str, str, str, Sequence[Any]], ...] = (
        ("1 fit", "fits", "fits", (1,)),
        ("4 fits", "fits", "fits", (4,)),
        ("{.iterations} iterations", "iterations", "fit", schedules),
        ("{} Gaussians per pixel", "population", "fit.gaussians_per_pixel", (0.1, 0.5)),
        ("first Gaussians every {} px", "start", "stride_px", (2, 5)),
        ("{} decode steps", "decode steps", "decode.iterations", (10, 160)),
        ("first look by {}", "first look", "first_look", looks),
        ("{} depth planes", "depth planes", "geometry.sweep.planes", (24, 192)),
        ("tracks through {} px", "windows", "geometry.tracks.window_px", (11, 31)),
        ("sweep through {} px", "windows", "geometry.sweep.window_px", (5, 11)),
        ("similarity through {} px", "windows", "fit.loss.window_px", (5, 21)),
        ("lists for 1 iteration", "list reuse", "raster.relist_every", (1,)),
        ("lists for {} iterations", "list reuse", "raster.relist_every", (8,)),
        ("blending to the end", "precision", "raster.termination_transmittance", (0.0,)),
        ("blending to {:.0%} of the light", "precision", "raster.termination_transmittance", (0.01, 0.1)),
    )
    for name, knob, setting, values in changes:
        found += [TradeoffTrial(name.format(value), knob, _changed(base, setting, value)) for value in values]
    return {trial.name: trial for trial in found}


def _changed(settings: Any, place: str, value: Any) -> Any:
    """Replace one setting, which lies at a place such as `fit.loss.window_px`."""
    name, _, rest = place.partition(".")
    return replace(settings, **{name: _changed(getattr(settings, name), rest, value) if rest else value})


TRIALS: Final = _trials()
KNOBS: Final = tuple(dict.fromkeys(trial.knob for trial in TRIALS.values()))


def chosen_trials(knobs: tuple[str, ...], others: tuple[str, ...] = ()) -> list[TradeoffTrial]:
    """Return the trials of some knobs, in order; the baseline is always among them.

    Args:
        knobs: Their names.
        others: Names of knobs whose trials are elsewhere.

    Raises:
        InputError: There is no such knob.
    """
    unknown = [knob for knob in knobs if knob not in (*KNOBS, *others)]
    if unknown:
        raise InputError(f"no knob {unknown[0]!r}", allowed=", ".join((*KNOBS, *others)))
    return [trial for trial in TRIALS.values() if trial.knob in knobs or trial.name == BASELINE]


def expected_seconds(trial: TradeoffTrial, standard_s: float) -> float:
    """Expect a trial's seconds from the standard's: by fits, iterations and pixels, whatever else the trial changes."""
    return standard_s * _work(trial) / _work(TRIALS[BASELINE])


def _work(trial: TradeoffTrial) -> float:
    """Return the iterations of all fits, one of the fine stage as two because it also renders a whole view."""
    settings = trial.settings
    fine = 0 if settings.fine is None else 2 * settings.fine.iterations
    fits = 1 if trial.exposures > 1 else settings.fits
    return trial.exposures * trial.fits * (fits * settings.fit.iterations + fine) / trial.shrink**2


def tried(shot: Shot, trial: TradeoffTrial, seed: int, clock: Callable[[], float] = time.monotonic) -> Row:
    """Run one trial on a shot; return its time and quality, with None for figures that are not known.

    `seconds` is the time from the measurement to the views at full size, registration included. `heldout_db` is −20 lg
    of the rms error of the predicted measurement on pixels that the trial did not see, in full scales of one view: the
    measurement's own noise limits it. The prediction uses the masks and weights that the trial corrected.
    """
    began_s = clock()
    registered = register(shot, trial.settings.registration, seed=seed)
    seen = registered.shot
    holdout = Holdout.of(seen, JUDGED_SHARE, seed ^ JUDGES, registered.averaged)
    treated = _treated(Registered(holdout.seen, averaged=registered.averaged), trial, seed)
    seconds = clock() - began_s
    return figures(
        trial, seconds, treated, Holdout(replace(seen, weights=treated.weights, truth=shot.truth), holdout.pixels)
    )


def figures(trial: TradeoffTrial, seconds: float, treated: "Treated", judging: Holdout) -> Row:
    """Return the row of a trial: its name, its seconds and the quality of what it made.

    Args:
        trial: The trial.
        seconds: That it took.
        treated: What it made.
        judging: The measurement with the weights that code this, and its pixels that the trial did not see.
    """
    truth, rms = judging.shot.truth.views, judging.residual_rms(treated.coded)
    return {
        "trial": trial.name,
        "knob": trial.knob,
        "seconds": seconds,
        "psnr_db": None if truth is None else float(np.mean(psnr_per_view(treated.views, truth))),
        "ssim": None if truth is None else float(np.mean(ssim_per_view(treated.views, truth))),
        "heldout_db": None if rms is None or math.isinf(rms) else -20 * math.log10(max(rms, RMS_FLOOR)),
        **treated.details,
    }


@dataclass(frozen=True)
class Treated:
    """What a trial made of a shot.

    Args:
        views: At full size, [N, H, W, C].
        coded: The views that the measurement codes, likewise: the light during each mask's time.
        weights: The weights that code them, [N].
        details: Further figures of the row.
    """

    views: F32
    coded: F32
    weights: F32
    details: Row


def _treated(registered: Registered, trial: TradeoffTrial, seed: int) -> Treated:
    """Treat a registered shot."""
    shot, settings = registered.shot, replace(trial.settings, seed=seed)
    if trial.shrink != 1:
        averaged = registered.averaged
        registered = Registered(
            shrunk(shot, trial.shrink),
            averaged=None if averaged is None else touched(averaged, trial.shrink, 2 if shot.cfa else 1),
        )
    small = registered.shot

    def full_size(views: F32) -> F32:
        return views if trial.shrink == 1 else enlarged(views, trial.shrink, shot.size)

    if not trial.fits:
        views = full_size(decode_by_name(small, settings.first_look, settings.decode))
        return Treated(views, views, shot.weights, {"iterations": 0, "gaussians": 0, "nate": None})
    result = reconstruct(small, settings, registered=registered).result
    views, truth = full_size(result.views), shot.truth.world_to_camera
    return Treated(
        views=views,
        coded=views if result.exposed_views is None else full_size(result.exposed_views),
        weights=shot.weights_by(result.brightness),
        details={
            "iterations": result.curve[-1].iteration if result.curve else 0,
            "gaussians": result.gaussians,
            "nate": None if truth is None else trajectory_errors(result.world_to_camera, truth).nate,
            "verdict": result.verdict,
            "stopped": result.stopped.code.value,
        },
    )
