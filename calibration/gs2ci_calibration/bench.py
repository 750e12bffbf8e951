"""The bench as calibration procedures use it: devices through their drivers, and an operator for manual steps.

A procedure is a function `measure(bench: Bench, known: Bundle) -> Section`: it requests an arrangement
(`bench.please(Arrangement.FLAT)`), takes frames (`bench.grab(patterns, frames=..., exposure_s=...)`), passes arrays to
pure estimators, and returns its estimates or raises `CalibrationError`. It never writes files and never sees the world
of a simulated bench. `known` holds the sections measured before (`known.need("dark-flat", step)`).

    bench.size, bench.modulator_size, bench.top_dn         sensor [H, W], modulator [Hm, Wm], largest reading
    bench.flat_pattern(is_open=True)                       [Hm, Wm] all mirrors on, or off, levels 0 and 1
    bench.deep(patterns of 0 and 1)                        the same at the capture's bit depth
    bench.lay_out(codes)                                   masks [N, h, w] at the sensor's pixels -> [N, Hm, Wm]
    bench.grab(patterns [N, Hm, Wm], frames=k, exposure_s) -> Stack: DN [N, k, H, W], pattern by pattern within a pass
    bench.expose(patterns, mask_s=, exposure_s=, frames=k) -> Stack: DN [1, k, H, W], one frame integrates all patterns
    bench.move({"x": mm})                                  move the stage and wait; returns positions in mm
    bench.codes, bench.capture                             the codes and the settings of `gs2ci capture`
    bench.options, bench.progress                          settings of the procedures; receives their progress

Not here: opening devices and the simulated operator (`gs2ci.rig`), files (`bundle`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Protocol

import numpy as np

from gs2ci.core.arrays import F32, F64, U8, U16
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress, Silent
from gs2ci_calibration.options import CalibrationOptions
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_drivers.acquisition import Devices, Taken, capture, plan_capture
from gs2ci_drivers.plan import CapturePlan, CaptureSettings, Mode, Travel
from gs2ci_drivers.sensor import SensorConfig
from gs2ci_drivers.stage import Stage

Patterns = U8 | U16

GUARD_S: Final = 1e-3
"""A pattern is shown this much longer than the sensor exposes, so that latency and jitter lose no light."""
RETRIES: Final = 2
"""How often a pass is repeated after a lost or corrupt frame."""


class Arrangement(Enum):
    """A physical arrangement that a procedure requests."""

    DARK = "dark"
    """The lens cap is on: no light reaches the sensor, whatever the modulator shows."""
    FLAT = "flat"
    """An evenly lit field fills the view (integrating sphere, opal glass, white screen out of focus)."""
    BOARD = "board"
    """The ChArUco board of `CalibrationOptions.board`, in a new pose for each index, as large as fits."""
    FIXED_BOARD = "fixed-board"
    """The same board at rest on a stand, facing the camera squarely and filling half of the view, the stage in
    mid-travel."""
    SCENE = "scene"
    """A textured scene at rest."""


class Operator(Protocol):
    """The operator who sets up arrangements: a person at the terminal, or the simulated one."""

    def please(self, setup: Arrangement, index: int) -> None:
        """Request an arrangement; return when it is set up.

        Args:
            setup: The arrangement.
            index: Which of several of its kind: the board's pose.
        """


@dataclass(frozen=True)
class Stack:
    """Raw frames.

    Args:
        readings: [N, K, H, W] float32 DN, raw: pattern n in pass k.
        time_s: When each exposure began, by the sensor's stamps, [N, K] seconds.
        exposure_s: The exposure time that the sensor reports.
        plan: The plan that was carried out.
        stage_mm: Counted position of the swept axis in the middle of each exposure, [N, K]; None at rest.
    """

    readings: F32
    time_s: F64
    exposure_s: float
    plan: CapturePlan
    stage_mm: F64 | None = None


@dataclass(frozen=True)
class Bench:
    """A bench to be calibrated; see the top of this file.

    Args:
        devices: Open devices of the rig.
        operator: Sets up the arrangements.
        config: The sensor's set-up; exposure and trigger are filled in for each stack.
        capture: The settings of `gs2ci capture` on this rig, its patterns [N, Hm, Wm] included, with its times as the
            modulator rounds them.
        codes: These patterns as drawn, levels at the sensor's pixels, [N, h, w] uint16.
        lay_out: Puts codes [N, h, w] onto the modulator's own pixels, [N, Hm, Wm], as `gs2ci capture` does.
        options: The rig file's [calibration].
        superpixel: Modulator pixels per side of one mask element, by design.
        directions: By the rig file, the motion of the camera per mm of each axis of the stage, in its own frame; an
            axis that is not named may have any direction.
        fast: Whether masks are predicted from affine, PSF and contrast instead of measured one by one.
        progress: Receives the stages and findings of the procedures; taking frames reports nothing.
    """

    devices: Devices
    operator: Operator
    config: SensorConfig
    capture: CaptureSettings
    codes: U16
    lay_out: Callable[[U16], Patterns]
    options: CalibrationOptions = field(default_factory=CalibrationOptions)
    superpixel: int = 1
    directions: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    fast: bool = False
    progress: Progress = field(default_factory=Silent)

    @property
    def size(self) -> tuple[int, int]:
        """Get the sensor's height and width as configured."""
        return self.config.height, self.config.width

    @property
    def modulator_size(self) -> tuple[int, int]:
        """Get the modulator's height and width."""
        info = self.devices.modulator.connect()
        return info.height, info.width

    @property
    def region(self) -> list[int | None]:
        """Get the first row and column of the sensor that are read out, [2]; None centres them."""
        return [self.config.top, self.config.left]

    @property
    def top_dn(self) -> int:
        """Get the largest reading of the format in use.

        Raises:
            DriverError: The sensor does not answer.
        """
        sensor = self.devices.sensor
        offered = sensor.connect().formats
        wanted = self.config.fourcc.strip()
        return next((one.top for one in offered if one.fourcc.strip() == wanted), offered[0].top)

    @property
    def gated(self) -> bool:
        """Get whether the sensor exposes while its line is held: its only mode, or the one wired for the capture."""
        return self.devices.sensor.connect().only_gated or self.capture.mode is Mode.GATE

    @property
    def exposure_limits_s(self) -> tuple[float, float]:
        """Get the shortest and the longest exposure that sensor and modulator share."""
        sensor, modulator = self.devices.sensor.connect(), self.devices.modulator.connect()
        if self.gated:
            return min(modulator.min_exposure_s.values()), modulator.max_exposure_s
        shortest = max(sensor.min_exposure_s, min(modulator.min_exposure_s.values()) - GUARD_S)
        return shortest, min(sensor.max_exposure_s, modulator.max_exposure_s - GUARD_S)

    @property
    def capacity(self) -> int:
        """Get how many patterns of the capture's depth one `grab` can show."""
        # A depth that the modulator lacks is refused by the plan, which lists the available ones.
        return self.devices.modulator.connect().capacity.get(self.capture.bit_depth, 1)

    def flat_pattern(self, *, is_open: bool) -> U8:
        """Return all mirrors on, or all off, [Hm, Wm] with levels 0 and 1."""
        return np.full(self.modulator_size, np.uint8(is_open))

    def deep(self, patterns: U8) -> Patterns:
        """Return patterns of 0 and 1, [N, Hm, Wm], with the levels of the capture's depth: closed, and fully open."""
        top = 2**self.capture.bit_depth - 1
        return patterns * (np.uint8(top) if top < 256 else np.uint16(top))

    def please(self, setup: Arrangement, index: int = 0) -> None:
        """Request an arrangement and wait until it is set up."""
        self.operator.please(setup, index)

    def planned(self) -> CapturePlan:
        """Lay out the capture of `gs2ci capture`; nothing moves and nothing is uploaded.

        Raises:
            DriverError: A device does not answer.
        """
        return plan_capture(self.devices, self.capture, self.config)

    def grab(
        self,
        patterns: Patterns,
        *,
        frames: int,
        exposure_s: float,
        bit_depth: int = 1,
        shown_s: float = 0.0,
        travel: Travel | None = None,
    ) -> Stack:
        """Take `frames` passes over all patterns, one frame per pattern in each pass.

        Args:
            patterns: [N, Hm, Wm], levels 0 to 2**bit_depth − 1; repeat references among them to interleave them.
            frames: Passes, K.
            exposure_s: Exposure of each frame; every pattern is shown a little longer.
            bit_depth: Bits of the patterns.
            shown_s: How long each pattern is shown, at least.
            travel: The stage's uniform motion during a pass, from the first pattern to the last; None for a stage at
                rest.

        Raises:
            PlanRefusedError: Patterns, exposure or travel are beyond the devices.
            DriverError: A device failed; all are at rest.
        """
        modulator = self.devices.modulator.connect()
        shortest_s = modulator.min_exposure_s.get(bit_depth, 0.0)  # 0: refused by the plan
        if self.gated:  # it exposes while a pattern is shown; a slower pass has dark time in between
            mask_s = modulator.quantise_s(max(exposure_s, shortest_s))
            dark_s, margin_s = modulator.quantise_s(max(shown_s - mask_s, 0.0)), 0.0
        else:
            mask_s = modulator.at_least_s(max(shown_s, exposure_s + GUARD_S, shortest_s))
            dark_s, margin_s = 0.0, mask_s - exposure_s
        settings = CaptureSettings(
            masks=patterns,
            bit_depth=bit_depth,
            mask_s=mask_s,
            dark_s=dark_s,
            margin_s=margin_s,
            mode=Mode.PER_MASK,
            shots=frames,
            travel=travel,
            retries=RETRIES,
            gated=self.gated,
        )
        return self._run(settings)

    def expose(self, patterns: Patterns, *, mask_s: float, exposure_s: float, frames: int, bit_depth: int = 1) -> Stack:
        """Take `frames` coded exposures, each of which spans all patterns; the stage is at rest.

        Args:
            patterns: [N, Hm, Wm].
            mask_s: How long each is shown.
            exposure_s: Exposure of the sensor, from its trigger at the first pattern; at most N `mask_s`. A gated
                sensor exposes during all patterns.
            frames: How many exposures, K.
            bit_depth: Bits of the patterns.

        Raises:
            PlanRefusedError: Patterns or exposure are beyond the devices.
            DriverError: A device failed; all are at rest.
        """
        mask_s = self.devices.modulator.connect().quantise_s(mask_s)
        settings = CaptureSettings(
            masks=patterns,
            bit_depth=bit_depth,
            mask_s=mask_s,
            mode=Mode.GATE if self.gated else Mode.PER_EXPOSURE,
            shots=frames,
            margin_s=len(patterns) * mask_s - exposure_s,
            retries=RETRIES,
        )
        return self._run(settings)

    def move(self, targets_mm: Mapping[str, float]) -> dict[str, float]:
        """Move the stage, wait for its arrival and return all positions in mm.

        Raises:
            CalibrationError: The rig has no stage (`Reason.NO_STAGE`).
            DriverError: Beyond the limits, not homed, or it stopped early.
        """
        return self.stage("stage").move_to(targets_mm)

    def stage(self, step: str) -> Stage:
        """Return the stage, connected.

        Raises:
            CalibrationError: The rig has none (`Reason.NO_STAGE`).
        """
        stage = self.devices.stage
        if stage is None:
            raise CalibrationError(
                step, Reason.NO_STAGE, "the rig has no stage", remedy="add a [stage] to the rig file"
            )
        stage.connect()
        return stage

    def _run(self, settings: CaptureSettings) -> Stack:
        if settings.shots < 1 or settings.masks.ndim != 3 or not settings.masks.size:
            raise InputError(
                f"{settings.shots} frames of patterns of shape {list(settings.masks.shape)}",
                allowed="1 frame or more of patterns [N, Hm, Wm]",
            )
        plan = plan_capture(self.devices, settings, self.config).require_sound()
        count = plan.frames_per_shot
        height, width = self.devices.sensor.settings.format.height, self.devices.sensor.settings.format.width
        readings = np.empty((count, settings.shots, height, width), np.float32)
        time_s, readout_s = np.empty((count, settings.shots)), self.devices.sensor.settings.readout_s
        stage_mm = np.full((count, settings.shots), np.nan)

        def keep(taken: Taken) -> None:
            for n, frame in enumerate(taken.frames):
                readings[n, taken.index] = frame.pixels
                time_s[n, taken.index] = frame.began_s(plan.exposure_s, readout_s)
            if taken.stage_mm is not None and len(taken.stage_mm) == count:
                stage_mm[:, taken.index] = self._in_the_middle_mm(plan, taken.stage_mm, time_s[:, taken.index])

        capture(self.devices, plan, keep)
        swept = plan.sweep is not None and bool(np.isfinite(stage_mm).all())
        return Stack(readings, time_s, plan.exposure_s, plan, stage_mm if swept else None)

    def _in_the_middle_mm(self, plan: CapturePlan, at_masks_mm: F64, began_s: F64) -> F64:
        """Return the counted position of the swept axis in the middle of each frame's exposure, [N].

        Args:
            plan: A plan with one frame per mask.
            at_masks_mm: Counted positions of the axes in the middle of each mask, [N, K].
            began_s: When exposures began, [N].
        """
        stage, sweep = self.devices.stage, plan.sweep
        if stage is None or sweep is None:
            return np.full(len(at_masks_mm), np.nan)
        column = tuple(stage.info.axes).index(sweep.axis)
        modulator, sensor = self.devices.modulator.info, self.devices.sensor.settings
        appeared_s = began_s[0] - plan.settings.begin_s(
            modulator.delay_s(plan.sequence.trigger), sensor.trigger_delay_s
        )
        after_s = began_s + plan.exposure_s / 2 - appeared_s - plan.sequence.windows_s().mean(axis=1)
        way = sweep.speed_mm_s * (1.0 if sweep.to_mm > sweep.from_mm else -1.0)
        return np.asarray(at_masks_mm[:, column] + way * after_s, np.float64)
