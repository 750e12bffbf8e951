"""The capture that a rig file requests, in the drivers' terms: mask codes, capture settings, the sensor's set-up.

Not here: planning and taking it (`recording`), calibrating for it (`calibrating`).
"""

from typing import Any

from numpy.typing import NDArray

from gs2ci.core.arrays import U16
from gs2ci.core.errors import InputError
from gs2ci.rig.opening import Rig
from gs2ci.rig.patterns import draw_codes, on_modulator
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.plan import CaptureSettings, KnownOptics, Mode, Travel
from gs2ci_drivers.sensor import SensorConfig


def intended(rig: Rig, devices: Devices) -> tuple[U16, CaptureSettings, SensorConfig]:
    """Connect, and return a rig file's requested capture: mask codes [N, H, W], the settings, the sensor's set-up.

    Raises:
        DriverError: A device does not answer.
        InputError: The masks do not fit on the modulator, or are far more than it holds.
    """
    table = rig.table
    modulator, config = devices.modulator.connect(), sensor_config(rig, devices)
    asked, most = table.capture.masks, modulator.capacity.get(table.capture.bit_depth, 0)
    if asked > 2 * most > 0 and not table.capture.pattern_file:  # a plan would say so, after minutes and gigabytes
        raise InputError(
            f"masks = {asked} in [capture]",
            allowed=f"at most {most}, which the {modulator.model} holds",
            remedy="take several exposures (`shots`) of fewer masks",
        )
    codes = draw_codes(table.capture, (config.height, config.width), rig.folder)
    masks = on_modulator(codes, table.registration, (modulator.height, modulator.width))
    return codes, _settings(rig, masks), config


def sensor_config(rig: Rig, devices: Devices) -> SensorConfig:
    """Connect the sensor, and return its set-up by the rig file; a side that it leaves open is the largest format's.

    Raises:
        DriverError: The sensor does not answer.
    """
    wanted = rig.table.sensor
    largest = max(devices.sensor.prepare().formats, key=lambda fmt: fmt.height * fmt.width)
    return SensorConfig(
        height=wanted.height or largest.height,
        width=wanted.width or largest.width,
        fourcc=wanted.format.strip(),
        gain_db=wanted.gain_db,
        buffers=wanted.buffers,
        warm_up_frames=wanted.warm_up_frames,
        controls=wanted.controls,
        top=wanted.top,
        left=wanted.left,
    )


def _optics(rig: Rig) -> KnownOptics:
    """Return what is known about lens and scene; for a rendered scene it is taken from the scene."""
    optics = rig.table.optics
    known = KnownOptics(optics.full_scale_e_per_s, optics.focal_px, optics.nearest_mm, optics.farthest_mm)
    light = rig.bench.light if rig.bench else None
    if light is None or rig.table.world is None or known.focal_px or known.nearest_mm:
        return known
    nearest, farthest = light.scene.depth_range()
    unit = rig.table.world.scene_units_per_mm
    focal_px = float(light.scene.intrinsics[0, 0])
    return KnownOptics(known.full_scale_e_per_s, focal_px, nearest / unit, farthest / unit)


def _settings(rig: Rig, masks: NDArray[Any]) -> CaptureSettings:
    capture = rig.table.capture
    travel = Travel(capture.axis, capture.from_mm, capture.to_mm) if capture.axis else None
    return CaptureSettings(
        masks=masks,
        bit_depth=capture.bit_depth,
        mask_s=capture.mask_s,
        dark_s=capture.dark_s,
        mode=Mode(capture.mode),
        shots=capture.shots,
        burst=capture.shots if capture.continuous else capture.burst,
        continuous=capture.continuous,
        turned=capture.turn_masks,
        ring=capture.ring,
        travel=travel,
        margin_s=capture.margin_s,
        jitter_s=capture.jitter_s,
        retries=capture.retries,
        optics=_optics(rig),
    )
