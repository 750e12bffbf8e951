"""Laying a capture out and checking it against what the devices can do. Nothing moves here.

From the devices' own limits and the user's settings it derives one pass of masks, the sensor's exposure, the readout
pause, the stage's sweep, and a figure for each check (reference section 5). Not here: the records
(`gs2ci_drivers.plan`), carrying the plan out (`gs2ci_drivers.acquisition`).
"""

from dataclasses import replace
from math import floor

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_drivers.axis import TOO_SLOW, Sweep, plan_sweep
from gs2ci_drivers.failures import DriverError
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, TriggerOut
from gs2ci_drivers.plan import CapturePlan, CaptureSettings, Figure, Mode
from gs2ci_drivers.sensor import SensorInfo, SensorSettings, TriggerMode
from gs2ci_drivers.stage import StageInfo

EXPOSURE_TOLERANCE = 0.1
"""Share by which an exposure may be shorter than requested: the weights of the masks account for the difference."""
CLOCK_TOLERANCE = 2e-4
"""Share by which an exposure may be longer than set, measured by the modulator's clock: two crystals, each off by up
to 100 ppm, as their data sheets allow."""
ROUNDING_TOLERANCE = 0.1
"""Share by which the modulator may round the time of a mask or of the darkness between masks."""
ROWS_TOLERANCE = 0.02
"""Share of a mask that the last rows of a rolling shutter may miss: the weights of the masks are those of all rows."""
LEAST_PARALLAX_PX = 0.4
"""What a turn of the camera explains of a path, so that near and far cannot be told (docs/stability.md)."""
_LISTED_STARTS = 8
"""So many starts of the modulator are listed with their first masks, as many as captures mostly have masks."""
BRIGHT_SHARE = 0.99
"""Share of the open pixels that must stay below the full well when the scene is white."""


def sensor_exposure_s(settings: CaptureSettings) -> float:
    """Return the exposure to request from the sensor, before the sensor rounds it.

    A gated sensor exposes while masks are on show, without a margin.
    """
    count = len(settings.masks)
    margin_s = 0.0 if settings.trigger_mode is TriggerMode.LEVEL else settings.margin_s
    if settings.mode is Mode.PER_MASK:
        return settings.mask_s - margin_s
    return count * settings.mask_s + (count - 1) * settings.dark_s - margin_s


def overlap_weights(windows_s: F64, start_s: float | F64, end_s: float | F64) -> F64:
    """Return the share of each mask's interval that lies inside an exposure, [N] in [0, 1].

    Args:
        windows_s: Start and end of each mask, [N, 2].
        start_s: Start of the exposure on the same clock, or of each mask's own, [N].
        end_s: Its end, or theirs.
    """
    begin, end = windows_s[:, 0], windows_s[:, 1]
    overlap = np.minimum(end, end_s) - np.maximum(begin, start_s)
    return np.asarray(np.clip(overlap, 0.0, None) / (end - begin), dtype=np.float64)


def lay_out(
    settings: CaptureSettings,
    modulator: ModulatorInfo,
    sensor: SensorInfo,
    setup: SensorSettings,
    stage: StageInfo | None,
) -> CapturePlan:
    """Lay out a capture and check it; broken limits are figures of the plan, not errors.

    Args:
        settings: The capture that the user wants.
        modulator: The modulator's limits.
        sensor: The sensor's limits.
        setup: The sensor's settings in force.
        stage: The stage's limits, or None.
    """
    asked, settings = settings, settings.rounded_for(modulator)
    sequence = _sequence(settings, modulator, setup)
    exposure_s = _exposure(settings, modulator, setup)
    windows = sequence.windows_s()
    delay_s = settings.begin_s(modulator.delay_s(sequence.trigger), setup.trigger_delay_s)
    begin_s = windows[:, 0] + delay_s if settings.mode is Mode.PER_MASK else np.full(len(windows), delay_s)
    weights = overlap_weights(windows, begin_s, begin_s + exposure_s)
    sweep, sweep_figures = _sweep(settings, sequence, modulator, stage)
    figures = [
        *_modulator_figures(settings, sequence, modulator),
        *_rounding_figures(asked, settings, modulator),
        *_sensor_figures(settings, sequence, exposure_s, sensor, setup, modulator),
        *_continuous_figures(settings, sequence, exposure_s, setup),
        *_light_figures(settings, sequence, weights, setup),
        *sweep_figures,
        *_parallax_figures(settings, sequence, sweep),
    ]
    frames = len(settings.masks) if settings.mode is Mode.PER_MASK else 1
    plan = CapturePlan(settings, sequence, exposure_s, frames, weights, sweep, tuple(figures))
    return replace(plan, figures=(*figures, *_order_figures(plan)))


def _exposure(settings: CaptureSettings, modulator: ModulatorInfo, setup: SensorSettings) -> float:
    if settings.trigger_mode is TriggerMode.LEVEL:
        return sensor_exposure_s(settings) + modulator.gate_longer_s + setup.exposure_offset_s
    return setup.exposure_s + setup.exposure_offset_s


def _busy_s(exposure_s: float, settings: CaptureSettings, modulator: ModulatorInfo, setup: SensorSettings) -> float:
    """Return for how long after the appearance of a mask a sensor may miss another edge."""
    delay_s = max(modulator.delay_s(settings.trigger_out), 0.0) + setup.trigger_delay_s
    taken_s = exposure_s * (1 + CLOCK_TOLERANCE) + setup.readout_s
    return max(taken_s, setup.link_s * (1 + CLOCK_TOLERANCE)) + settings.jitter_s + delay_s


def _sequence(settings: CaptureSettings, modulator: ModulatorInfo, setup: SensorSettings) -> PatternSequence:
    """Return the sequence, with dark time wherever the sensor needs it for its readout."""
    busy_s = _busy_s(_exposure(settings, modulator, setup), settings, modulator, setup)
    dark_s, pause_s = settings.dark_s, 0.0
    if settings.mode is Mode.PER_MASK:
        dark_s = max(dark_s, busy_s - settings.mask_s)
        if settings.trigger_mode is TriggerMode.LEVEL:  # the line must fall between masks
            dark_s = max(dark_s, modulator.min_dark_s)
        dark_s = _allowed_dark(dark_s, modulator)
        pause_s = dark_s
    elif settings.burst > 1:
        shown_s = len(settings.masks) * settings.mask_s + (len(settings.masks) - 1) * dark_s
        pause_s = busy_s - shown_s
        if settings.mode is Mode.GATE:
            pause_s = max(pause_s, setup.readout_s + settings.jitter_s)
        pause_s = modulator.pause_at_least_s(pause_s, settings.mask_s, dark_s) if pause_s > 0 else 0.0
    return PatternSequence(
        masks=settings.masks,
        bit_depth=settings.bit_depth,
        exposure_s=settings.mask_s,
        dark_s=dark_s,
        pause_s=pause_s,
        repeats=settings.burst,
        trigger=settings.trigger_out,
    )


def _allowed_dark(dark_s: float, modulator: ModulatorInfo) -> float:
    """Return a dark time that is long enough and that the device can keep."""
    return modulator.at_least_s(max(dark_s, modulator.min_dark_s)) if dark_s > 0 else 0.0


def _modulator_figures(settings: CaptureSettings, sequence: PatternSequence, info: ModulatorInfo) -> list[Figure]:
    depth = settings.bit_depth
    if depth not in info.min_exposure_s:
        depths = ", ".join(str(bits) for bits in sorted(info.min_exposure_s))
        return [Figure("mask depth", f"{depth} bits", f"{depths} bits", broken=True, remedy="set `bit_depth`")]
    shortest, count = info.min_exposure_s[depth], len(settings.masks)
    shape = settings.masks.shape[1:]
    slack_s = info.exposure_step_s / 2
    outs = ", ".join(sorted(out.value for out in info.trigger_outs))
    return [
        Figure(
            "masks",
            f"{count} of {shape[0]} x {shape[1]} at {depth} bit",
            f"at most {info.capacity[depth]} of {info.height} x {info.width}",
            broken=count > info.capacity[depth] or shape != (info.height, info.width),
            remedy="use fewer masks, or masks laid out on the modulator's own pixels",
        ),
        Figure(
            "time per mask",
            f"{sequence.exposure_s * 1e6:.0f} us",
            f"{shortest * 1e6:.0f} to {info.max_exposure_s * 1e6:.0f} us",
            broken=not shortest - slack_s <= sequence.exposure_s <= info.max_exposure_s + slack_s,
            remedy="set `mask_s` inside these limits or use fewer bits",
        ),
        Figure("one pass", f"{sequence.period_s * 1e3:.3f} ms, of it {sequence.pause_s * 1e3:.3f} ms pause"),
        Figure(
            "trigger output",
            sequence.trigger.value,
            outs,
            broken=sequence.trigger not in info.trigger_outs,
            remedy="choose another `mode`, or a modulator that can hold its line for each mask",
        ),
        *_unsettled(sequence, info),
        *_unsettled_grey(settings, info),
        Figure(
            "shots",
            f"{settings.shots} in bursts of {settings.burst}",
            "1 or more, a multiple of `burst`",
            broken=settings.shots < 1 or settings.burst < 1 or settings.shots % max(settings.burst, 1) != 0,
            remedy="set `shots` and `burst`",
        ),
    ]


def _order_figures(plan: CapturePlan) -> list[Figure]:
    """Return a figure if each start of the modulator begins with another mask."""
    if not plan.turns:
        return []
    first = ", ".join(str(plan.first_mask(fire) + 1) for fire in range(min(plan.fires, _LISTED_STARTS)))
    more = ", ..." if plan.fires > _LISTED_STARTS else ""
    return [Figure("first mask", f"another one in each start of the modulator: {first}{more}")]


def _rounding_figures(asked: CaptureSettings, settings: CaptureSettings, info: ModulatorInfo) -> list[Figure]:
    """Return a figure for each time that the modulator rounds by more than two clocks may differ anyway."""
    step_s, figures = info.exposure_step_s, []
    for key, what, least_s in (
        ("mask_s", "rounded time per mask", info.min_exposure_s.get(asked.bit_depth, step_s)),
        ("dark_s", "rounded dark time", info.min_dark_s),
    ):
        asked_s, shown_s = getattr(asked, key), getattr(settings, key)
        off_s = abs(shown_s - asked_s)
        if off_s <= CLOCK_TOLERANCE * asked_s:
            continue
        around_s = floor(asked_s / step_s) * step_s, info.at_least_s(max(asked_s, least_s))
        nearest = " or ".join(f"{near_s:.7g}" for near_s in around_s if near_s >= info.at_least_s(least_s))
        figures.append(
            Figure(
                what,
                f"{shown_s * 1e3:.3f} ms for {key} = {asked_s:.7g} s",
                f"steps of {step_s * 1e3:.3f} ms; {nearest} s",
                broken=off_s > ROUNDING_TOLERANCE * asked_s,
                remedy=f"set `{key}` to {nearest}",
            )
        )
    return figures


def _unsettled(sequence: PatternSequence, info: ModulatorInfo) -> list[Figure]:
    """Refuse trigger pulses while it is unknown with which masks they come: a frame of wrong masks looks normal."""
    pulsed = sequence.trigger in (TriggerOut.PER_EXPOSURE, TriggerOut.PER_MASK)
    if not pulsed or not info.pulses_unsettled:
        return []
    return [
        Figure(
            "trigger pulses",
            info.pulses_unsettled,
            "a stated one",
            broken=True,
            remedy="run `gs2ci doctor`, which determines them, and write its result into [modulator]",
        )
    ]


def _unsettled_grey(settings: CaptureSettings, info: ModulatorInfo) -> list[Figure]:
    """Refuse grey masks that are assumed to be as drawn on a modulator whose light does not follow the drawn level."""
    top = 2**settings.bit_depth - 1
    coded = settings.mode is not Mode.PER_MASK  # frames of single masks are how masks are measured
    if not coded or settings.measured or not info.grey_unsettled or settings.bit_depth == 1:
        return []
    if not any(bool(((mask > 0) & (mask < top)).any()) for mask in settings.masks):
        return []
    return [
        Figure(
            "grey masks",
            f"as drawn; {info.grey_unsettled}",
            "measured ones",
            broken=True,
            remedy="calibrate them (`gs2ci calibrate all`), use binary masks, or, if the lamp follows the controller's "
            'LED enables, set lamp = "switched" in [modulator]',
        )
    ]


def _sensor_figures(
    settings: CaptureSettings,
    sequence: PatternSequence,
    exposure_s: float,
    info: SensorInfo,
    setup: SensorSettings,
    modulator: ModulatorInfo,
) -> list[Figure]:
    busy_s = _busy_s(exposure_s, settings, modulator, setup)
    per_mask = settings.mode is Mode.PER_MASK
    period_s = sequence.exposure_s + sequence.dark_s if per_mask else sequence.period_s
    alone = not per_mask and settings.burst == 1
    shown_s = sequence.exposure_s if per_mask else float(sequence.windows_s()[-1, 1])
    triggers = ", ".join(sorted(mode.value for mode in info.triggers))
    needed_s = (1 - EXPOSURE_TOLERANCE) * sensor_exposure_s(settings) - info.exposure_step_s
    longest_s = shown_s + sequence.pause_s + settings.jitter_s
    return [
        Figure(
            "exposure",
            f"{exposure_s * 1e3:.3f} ms",
            f"{needed_s * 1e3:.3f} ms, which its masks need, or more"
            if alone
            else f"{needed_s * 1e3:.3f} to {longest_s * 1e3:.3f} ms, after which other masks follow",
            broken=exposure_s < needed_s or (not alone and exposure_s > longest_s),
            remedy="change `mask_s` or `margin_s`; the sensor may lack longer exposures or ignore the control",
        ),
        Figure(
            "exposure + readout",
            f"{busy_s * 1e3:.3f} ms" + (", by its link" if setup.link_s > exposure_s + setup.readout_s else ""),
            "" if alone else f"at most the trigger period of {period_s * 1e3:.3f} ms",
            broken=not alone and busy_s > period_s + modulator.exposure_step_s,
            remedy="raise `mask_s` or `dark_s`, or reduce the sensor's size",
        ),
        *_rolling(settings, sequence, setup),
        *_unsettled_exposure(settings, info),
        Figure(
            "sensor trigger",
            setup.trigger.value,
            triggers,
            broken=setup.trigger is not settings.trigger_mode and setup.trigger is not TriggerMode.FREE_RUN,
            remedy="set `trigger_adapter` in [sensor] or choose another `mode`",
        ),
    ]


def _rolling(settings: CaptureSettings, sequence: PatternSequence, setup: SensorSettings) -> list[Figure]:
    """Refuse a code whose first and last mask reach some rows only; single masks lose the same share each."""
    if not setup.rows_s or settings.mode is Mode.PER_MASK:
        return []
    share = setup.rows_s / sequence.exposure_s
    return [
        Figure(
            "rolling shutter",
            f"rows begin within {setup.rows_s * 1e3:.3f} ms, {share:.1%} of a mask",
            f"at most {ROWS_TOLERANCE:.0%} of a mask, which the last rows miss of the first one",
            broken=share > ROWS_TOLERANCE,
            remedy="use a sensor that exposes all rows at once, read out fewer rows, or set `mask_s` to "
            f"{setup.rows_s / ROWS_TOLERANCE:.3g} or more",
        )
    ]


def _unsettled_exposure(settings: CaptureSettings, info: SensorInfo) -> list[Figure]:
    """Refuse exposures of an unknown unit; those of a gated sensor last as long as its line is held."""
    if not info.exposure_unsettled or settings.trigger_mode is TriggerMode.LEVEL:
        return []
    return [
        Figure(
            "unit of exposure",
            info.exposure_unsettled,
            "a stated one",
            broken=True,
            remedy="run `gs2ci doctor`, which measures it, and write its result into [sensor]",
        )
    ]


def _continuous_figures(
    settings: CaptureSettings, sequence: PatternSequence, exposure_s: float, setup: SensorSettings
) -> list[Figure]:
    """Return the figures of a continuous capture: its rate, and how many shots may wait to be written."""
    if not settings.continuous:
        return []
    shown_s = float(sequence.windows_s()[-1, 1])
    waiting_s = settings.ring * sequence.period_s
    waiting_mb = settings.ring * setup.format.height * setup.format.width * 2 / 1e6
    still, one_frame = settings.travel is None, settings.mode is not Mode.PER_MASK
    return [
        Figure(
            "continuous",
            f"{1 / sequence.period_s:.2f} exposures a second: masks for {shown_s * 1e3:.3f} ms, then "
            f"{sequence.pause_s * 1e3:.3f} ms for the rest of the {(exposure_s + setup.readout_s) * 1e3:.3f} ms that "
            f"exposure and readout take; settling once, at the end"
            if one_frame
            else settings.mode.value,
            "per-exposure or gate, without a travel",
            broken=not still or not one_frame,
            remedy="set continuous = false in [capture], or leave `axis` out and choose another `mode`",
        ),
        Figure(
            "writing",
            f"during the next exposures; {settings.ring} may wait: they bridge {waiting_s:.2f} s of a busy disk and "
            f"take {waiting_mb:.1f} MB",
        ),
    ]


def _light_figures(
    settings: CaptureSettings, sequence: PatternSequence, weights: F64, setup: SensorSettings
) -> list[Figure]:
    rate = settings.optics.full_scale_e_per_s
    if rate is None:
        return []
    top = 2**settings.bit_depth - 1
    if settings.mode is Mode.PER_MASK:
        open_s = sequence.exposure_s * float(weights.max())
    else:
        # A white scene behind the mask pixels that are open longest; the last percent may clip and be marked.
        # The masks are summed one by one: all of them as floating-point numbers take gigabytes.
        shares = np.zeros(settings.masks.shape[1:])
        for weight, mask in zip(weights, settings.masks, strict=True):
            shares += weight / top * mask
        open_s = sequence.exposure_s * float(np.quantile(shares[shares > 0], BRIGHT_SHARE)) if shares.any() else 0.0
    charge = rate * open_s
    well = setup.full_well_e
    return [
        Figure(
            "bright pixels of a white scene",
            f"{charge:.0f} e-",
            f"at most the full well of {well:.0f} e-" if well else "",
            broken=well is not None and charge > well,
            remedy="shorten `mask_s`, use fewer open mask pixels or dim the lamp",
        )
    ]


def _sweep(
    settings: CaptureSettings, sequence: PatternSequence, modulator: ModulatorInfo, stage: StageInfo | None
) -> tuple[Sweep | None, list[Figure]]:
    travel = settings.travel
    if travel is None:
        return None, []
    value = f"{travel.axis} from {travel.from_mm:g} to {travel.to_mm:g} mm"
    if stage is None or travel.axis not in stage.axes:
        axes = ", ".join(stage.axes) if stage else "none: the rig has no stage"
        return None, [Figure("travel", value, f"axes {axes}", broken=True, remedy="name an axis of the stage")]
    axis = stage.axes[travel.axis]
    shown_s = float(sequence.windows_s()[-1, 1])
    asked_mm_s = abs(travel.to_mm - travel.from_mm) / shown_s
    speed = axis.quantise_speed_mm_s(asked_mm_s) if asked_mm_s >= axis.min_speed_mm_s else asked_mm_s
    guard_mm = speed * (modulator.start_latency_s or 0.0) * (1 if travel.to_mm > travel.from_mm else -1)
    whole = sequence.duration_s - sequence.period_s
    end_mm = travel.to_mm + guard_mm + (speed * whole if guard_mm >= 0 else -speed * whole)
    try:
        sweep = plan_sweep("stage", axis, travel.from_mm - guard_mm, end_mm, speed)
    except DriverError as error:
        limit, slow = error.allowed or f"up to {axis.max_speed_mm_s:g} mm/s", TOO_SLOW in error.problem
        said = f"{value} at {speed:.3g} mm/s, which{TOO_SLOW}" if slow else f"{value} at {speed:.3f} mm/s"
        remedy = "lower `mask_s`, lengthen the travel" if slow else "raise `mask_s`, shorten the travel"
        remedy += ", or move it inside the stage's limits"
        return None, [Figure("travel", said, limit, broken=True, remedy=remedy)]
    return sweep, [
        Figure("stage speed", f"{speed:.4f} mm/s", axis.speeds),
        Figure(
            "stage travel",
            f"{sweep.begin_mm:.3f} to {sweep.end_mm:.3f} mm with ramps",
            f"{axis.min_mm:g} to {axis.max_mm:g} mm",
        ),
    ]


def _parallax_figures(settings: CaptureSettings, sequence: PatternSequence, sweep: Sweep | None) -> list[Figure]:
    optics = settings.optics
    if sweep is None or not optics.focal_px or not optics.nearest_mm:
        return []
    baseline_mm = sweep.speed_mm_s * float(sequence.windows_s()[-1, 1])
    near_px = optics.focal_px * baseline_mm / optics.nearest_mm
    far_px = optics.focal_px * baseline_mm / optics.farthest_mm if optics.farthest_mm else 0.0
    blur_px = near_px * sequence.exposure_s / float(sequence.windows_s()[-1, 1])
    small = "; too little for depth" if near_px - far_px < LEAST_PARALLAX_PX else ""
    return [
        Figure("motion in the picture", f"{near_px:.2f} px near, {far_px:.2f} px far over one exposure"),
        Figure("parallax", f"{near_px - far_px:.2f} px between near and far{small}"),
        Figure("blur within one mask", f"up to {blur_px:.2f} px"),
    ]
