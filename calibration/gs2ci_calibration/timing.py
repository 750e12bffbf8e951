"""When a triggered exposure begins and ends: latency, jitter and length, and which masks it overlaps.

Here: the procedure `measure` and its pure estimators. Not here: how masks are weighted in a capture
(`gs2ci_drivers.planning.overlap_weights`, which is used).

Method. Four patterns of duration τ each follow one another while the sensor exposes once, for E = 2 τ + h from its
trigger at the first pattern's appearance, that is from L to L + E + o. The signals, at brightness r, give the times:

    edge       open shut shut shut      r (τ − L)         exposure begins within the open pattern
    inside     shut open shut shut      r τ               the reference: the open pattern is exposed completely
    length     open shut open shut      r (τ + h + o)     exposure begins in one open pattern and ends in the other
    closed     shut shut shut shut      0

Each is divided by `inside`, so that brightness and a non-linear response cancel; they are interleaved, so that a drift
of the lamp cancels as well. τ is swept: a true latency must not depend on it.
"""

from dataclasses import dataclass
from math import ceil
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_calibration.bench import Arrangement, Bench, Patterns
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.fitting import needed, times_of
from gs2ci_calibration.frames import Dark, check_flicker, check_stack, refuse_dark, root
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_drivers.plan import Mode
from gs2ci_drivers.planning import overlap_weights

STEP: Final = "timing"
OPEN: Final = {
    "edge": (True, False, False, False),
    "inside": (False, True, False, False),
    "length": (True, False, True, False),
    "closed": (False, False, False, False),
}
ORDER: Final = ("closed", "inside", "edge", "length", "length", "edge", "inside", "closed")
"""Symmetric in time, so that a steady drift affects all kinds equally."""
COARSE_S: Final = (4e-3, 40e-3)
"""Times per pattern of the coarse measurement; the longer one is for devices with a long latency."""
COARSE_SPARE: Final = 0.25
"""h over τ of the coarse measurement."""
FINE_S: Final = 0.5e-3
SWEEP: Final = (1.0, 1.5, 2.0)
"""Times per pattern of the sweep, relative to the shortest of them."""
SPARE_S: Final = 50e-6
STEP_S: Final = 10e-6
"""Times are multiples of this, which any modulator can keep and which is about a line of most sensors."""
FULLY: Final = 0.93
"""Largest share of the coarse pattern that latency or excess length may take."""
ERROR_LIMIT_S: Final = 1e-6
"""Largest standard error of the latency: the truth is then within 2 µs."""
WANTED_ERROR_S: Final = 0.7e-6
MOST_ROUNDS: Final = 7
"""Largest number of repetitions of the sweep, which is repeated until the latency is known to `ERROR_LIMIT_S`."""
CONSISTENT: Final = 25.0
"""Largest χ² per degree of freedom over the sweep."""


def measure(bench: Bench, known: Bundle) -> Section:
    """Sweep the delay between trigger and light on the flat field and return the section `timing`.

    Raises:
        CalibrationError: `dark-flat` is missing; no edge is found; light too weak or unsteady; results of the sweep
            contradict each other.
        DriverError: A device failed.
    """
    if not bench.devices.modulator.connect().hardware_timed:
        raise CalibrationError(
            STEP,
            Reason.NO_LATENCY,
            "the host steps this modulator's patterns: they have no time of their own",
            allowed="a modulator that times its patterns itself",
            remedy="capture with mode = 'per-mask', which needs no latency",
        )
    if bench.gated:
        raise CalibrationError(
            STEP,
            Reason.NO_LATENCY,
            "this sensor exposes as long as the modulator holds its line: no exposure ends by the sensor's own clock",
            allowed="a sensor with an edge trigger",
            remedy="leave this step out: the step `masks` measures by light what share of each mask is exposed",
        )
    dark = Dark.of(needed(known, "dark-flat", bench, STEP))
    bench.please(Arrangement.FLAT)
    coarse = _first_look(bench, dark)
    shortest_s = max(FINE_S, 2 * _shortest_s(bench), 2.5 * (abs(coarse.latency_s) + abs(coarse.offset_s)))
    spare_s = SPARE_S + 2 * max(-(coarse.latency_s + coarse.offset_s), 0.0)
    times_s = [_rounded(shortest_s * factor) for factor in SWEEP]
    looks = _sweep(bench, dark, times_s, _rounded(spare_s), 1)
    looks += _sweep(bench, dark, times_s, _rounded(spare_s), _rounds_missing(looks))
    found = estimate(looks, bench.devices.modulator.info.trigger_delay_s)
    return _section(bench, found, looks)


@dataclass(frozen=True)
class Look:
    """Signals of the four kinds of patterns, at one time per pattern.

    Args:
        pattern_s: τ.
        exposure_s: E, as set on the sensor.
        levels_dn: For each kind the mean signal of each frame, [K] DN.
        noise_dn2: Variance of these means by the pixels' noise.
    """

    pattern_s: float
    exposure_s: float
    levels_dn: dict[str, F64]
    noise_dn2: dict[str, float]

    def ratio(self, kind: str) -> tuple[float, float]:
        """Return the signal of a kind over that of `inside`, and its standard error."""
        shut, inside, other = (self.levels_dn[name] for name in ("closed", "inside", kind))
        below, above = float(inside.mean() - shut.mean()), float(other.mean() - shut.mean())
        if below <= 0:
            refuse_dark(STEP, below)
        value = above / below
        errors = [_square_error(other), value**2 * _square_error(inside), (1 - value) ** 2 * _square_error(shut)]
        return value, float(np.sqrt(sum(errors))) / below


@dataclass(frozen=True)
class Coarse:
    """First guesses.

    Args:
        latency_s: From the first pattern's appearance to the start of exposure.
        offset_s: Excess of the exposure over the configured one.
    """

    latency_s: float
    offset_s: float


@dataclass(frozen=True)
class TimingEstimate:
    """The estimates from the sweep; pairs are a value and its standard error.

    Args:
        latency_s: From the trigger's edge to the start of exposure.
        jitter_s: Standard deviation of the latency.
        exposure_offset_s: Excess of an exposure over the configured one.
        flicker: Relative flicker of the light from frame to frame.
    """

    latency_s: tuple[float, float]
    jitter_s: tuple[float, float]
    exposure_offset_s: tuple[float, float]
    flicker: float


def estimate(looks: list[Look], trigger_delay_s: float) -> TimingEstimate:
    """Estimate the times from a sweep.

    Args:
        looks: The signals at each time per pattern.
        trigger_delay_s: From a pattern's appearance to the trigger's edge, as set on the modulator.

    Raises:
        CalibrationError: No light, light that flickers, times that change with τ, or that are too uncertain.
    """
    flicker = _check_lamp(looks)
    begins = np.array([_begin(look) for look in looks])
    lengths = np.array([_excess(look) for look in looks])
    latency, offset = _combined(begins, "latency"), _combined(lengths, "length of the exposure")
    if latency[1] > ERROR_LIMIT_S:
        raise CalibrationError(
            STEP,
            Reason.TOO_FEW_FRAMES,
            f"the latency is known to {latency[1] * 1e6:.1f} us only",
            allowed=f"a standard error of {ERROR_LIMIT_S * 1e6:.0f} us",
            remedy="brighten the lamp, or raise `frames` in [calibration]",
        )
    jitter = _jitter(looks)
    return TimingEstimate((latency[0] - trigger_delay_s, latency[1]), jitter, offset, flicker)


def overlap(windows_s: F64, exposure_s: float, latency_s: float, offset_s: float, trigger_delay_s: float) -> F64:
    """Return the share of each mask's time that a capture with these times exposes, [N].

    Args:
        windows_s: Start and end of each mask, [N, 2].
        exposure_s: The exposure in force, as the sensor rounds it.
        latency_s: From the trigger's edge to the start of exposure.
        offset_s: Excess of the exposure over the one in force.
        trigger_delay_s: From a mask's appearance to the trigger's edge.
    """
    begin_s = trigger_delay_s + latency_s
    return overlap_weights(windows_s, begin_s, begin_s + exposure_s + offset_s)


def _square_error(levels: F64) -> float:
    return float(levels.var(ddof=1)) / len(levels)


def _shortest_s(bench: Bench) -> float:
    return min(bench.devices.modulator.info.min_exposure_s.values())


def _rounded(time_s: float) -> float:
    return ceil(time_s / STEP_S - 1e-6) * STEP_S  # 1e-6 steps: rounding error of the division


def _sweep(bench: Bench, dark: Dark, times_s: list[float], spare_s: float, rounds: int) -> list[Look]:
    looks: list[Look] = []
    if rounds:
        bench.progress.stage("delay sweep", rounds * len(times_s))
    for pattern_s in times_s * rounds:
        looks.append(_look(bench, dark, pattern_s, spare_s, bench.options.frames))
        bench.progress.step(len(looks), latency_us=1e6 * _begin(looks[-1])[0], pattern_us=1e6 * pattern_s)
    return looks


def _rounds_missing(looks: list[Look]) -> int:
    """Return how many more sweeps are needed for the required error of the latency, at most `MOST_ROUNDS`."""
    _, error = _combined(np.array([_begin(look) for look in looks]), "latency")
    return min(ceil((error / WANTED_ERROR_S) ** 2) - 1, MOST_ROUNDS)


def _first_look(bench: Bench, dark: Dark) -> Coarse:
    for pattern_s in COARSE_S:
        look = _look(bench, dark, pattern_s, COARSE_SPARE * pattern_s, 4)
        begin, _ = _begin(look)
        excess, _ = _excess(look)
        if begin < FULLY * pattern_s and begin + excess > -FULLY * COARSE_SPARE * pattern_s:
            return Coarse(begin, excess)
    raise CalibrationError(
        STEP,
        Reason.NO_LATENCY,
        f"no light of the first {COARSE_S[-1] * 1e3:.0f} ms after the trigger is seen, or none of the last",
        allowed=f"a latency of up to {FULLY * COARSE_S[-1] * 1e3:.0f} ms",
        remedy="check the trigger line, its polarity, and that the sensor exposes as long as it is set to",
    )


def _look(bench: Bench, dark: Dark, pattern_s: float, spare_s: float, frames: int) -> Look:
    """Take all kinds of patterns, each in two halves; `edge` gets twice the frames of the others, for the jitter."""
    pattern_s = bench.devices.modulator.connect().quantise_s(pattern_s)
    good, levels, noises = dark.good, {kind: list[F64]() for kind in OPEN}, {kind: list[float]() for kind in OPEN}
    exposure_s = 2 * pattern_s + spare_s
    for kind in ORDER:
        count = max(frames // 2 if kind == "edge" else frames // 4, 2)
        shown: Patterns = np.stack([bench.flat_pattern(is_open=is_open) for is_open in OPEN[kind]])
        stack = bench.expose(shown, mask_s=pattern_s, exposure_s=exposure_s, frames=count)
        check_stack(STEP, stack.readings[0])
        pixels = stack.readings[0][:, good].astype(np.float64)
        levels[kind].append(pixels.mean(axis=1))
        noises[kind].append(float(pixels.var(axis=0, ddof=1).mean()) / int(good.sum()))
    return Look(
        pattern_s,
        bench.devices.sensor.settings.exposure_s,
        {kind: np.concatenate(parts) for kind, parts in levels.items()},
        {kind: float(np.mean(parts)) for kind, parts in noises.items()},
    )


def _begin(look: Look) -> tuple[float, float]:
    value, error = look.ratio("edge")
    return look.pattern_s * (1 - value), look.pattern_s * error


def _excess(look: Look) -> tuple[float, float]:
    value, error = look.ratio("length")
    return look.pattern_s * (value + 1) - look.exposure_s, look.pattern_s * error


def _combined(found: F64, what: str) -> tuple[float, float]:
    """Return the weighted mean of values with standard errors, [n, 2]; its error grows with their disagreement."""
    values, errors = found.T
    weights = 1 / np.square(errors)
    mean = float(weights @ values / weights.sum())
    chi = float(weights @ np.square(values - mean)) / max(len(values) - 1, 1)
    if chi > CONSISTENT:
        seen = ", ".join(f"{value * 1e6:.1f}" for value in values)
        raise CalibrationError(
            STEP,
            Reason.BAD_FIT,
            f"the {what} changes with the time per pattern: {seen} us",
            allowed="the same at each, within its noise",
            remedy="check that the modulator keeps its times and that nothing else triggers the sensor",
        )
    return mean, float(np.sqrt(max(chi, 1.0) / weights.sum()))


def _check_lamp(looks: list[Look]) -> float:
    """Return the light's rms change from frame to frame, beyond the pixels' own noise.

    Raises:
        CalibrationError: It is too large.
    """
    flicker, error = root(*_excess_variance(looks, ("inside", "length"), relative=True))
    check_flicker(STEP, flicker, error)
    return flicker


def _jitter(looks: list[Look]) -> tuple[float, float]:
    """Return the scatter of the latency: that of `edge` beyond the pixels' noise and the lamp's, known from the others.

    In `length` a later start is also a later end, so its signal does not change.
    """
    with_jitter, error = _excess_variance(looks, ("edge",), relative=False)
    by_lamp, lamp_error = _excess_variance(looks, ("inside", "length"), relative=False)
    return root(with_jitter - by_lamp, float(np.hypot(error, lamp_error)))


def _excess_variance(looks: list[Look], kinds: tuple[str, ...], *, relative: bool) -> tuple[float, float]:
    """Return by how much frames of some kinds vary beyond their pixels' own noise, with its standard error.

    Args:
        looks: The signals at each time per pattern.
        kinds: The kinds of patterns.
        relative: Whether relative to the signal; otherwise in seconds of light, squared.

    Raises:
        CalibrationError: There is no light.
    """
    rows = []
    for look in looks:
        shut = float(look.levels_dn["closed"].mean())
        inside = float(look.levels_dn["inside"].mean()) - shut
        for kind in kinds:
            levels = look.levels_dn[kind]
            signal = float(levels.mean()) - shut
            if min(signal, inside) <= 0:
                refuse_dark(STEP, min(signal, inside))
            scale = 1 / signal**2 if relative else (look.pattern_s / inside) ** 2
            rows.append((scale * levels.var(ddof=1), scale * look.noise_dn2[kind], len(levels) - 1))
    variance, noise, freedom = np.array(rows).T
    # Weights by the expected variance, not the sample's: a sample that varies little by chance is not more precise.
    weights = freedom / np.square(noise)
    weights /= weights.sum()
    excess = float(weights @ (variance - noise))
    errors = (noise + max(excess, 0.0)) * np.sqrt(2 / freedom)
    return excess, float(np.sqrt(np.square(weights) @ np.square(errors)))


def _section(bench: Bench, found: TimingEstimate, looks: list[Look]) -> Section:
    estimates = {
        "latency_s": Estimate(*found.latency_s, "s"),
        "jitter_s": Estimate(*found.jitter_s, "s"),
        "exposure_offset_s": Estimate(*found.exposure_offset_s, "s"),
    }
    if bench.capture.mode is Mode.PER_EXPOSURE:
        windows_s, exposure_s = bench.planned().sequence.windows_s(), bench.devices.sensor.settings.exposure_s
        delay_s = bench.devices.modulator.info.trigger_delay_s
        latency, offset = found.latency_s[0], found.exposure_offset_s[0]
        weights = overlap(windows_s, exposure_s, latency, offset, delay_s)
        by_latency = overlap(windows_s, exposure_s, latency + found.latency_s[1], offset, delay_s) - weights
        by_offset = overlap(windows_s, exposure_s, latency, offset + found.exposure_offset_s[1], delay_s) - weights
        estimates["weights"] = Estimate(weights, np.hypot(by_latency, by_offset), "1")
    return Section(
        name=STEP,
        estimates=estimates,
        facts={
            "pattern_s": [look.pattern_s for look in looks],
            "frames": bench.options.frames,
            "flicker": found.flicker,
            **times_of(bench.capture),
            "mode": bench.capture.mode.value,
        },
    )
