"""The capture that a rig file requests, in the drivers' terms: mask codes, capture settings, the sensor's set-up.

Not here: planning and taking it (`recording`), calibrating for it (`calibrating`).
"""

from typing import Any

from numpy.typing import NDArray

from gs2ci.core.arrays import U16
from gs2ci.rig.opening import Rig
from gs2ci.rig.patterns import draw_codes, on_modulator
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.plan import CaptureSettings, KnownOptics, Mode, Travel
from gs2ci_drivers.sensor import SensorConfig


def intended(rig: Rig, devices: Devices) -> tuple[U16, CaptureSettings, SensorConfig]:
    """Connect, and return a rig file's requested capture: mask codes [N, H, W], the settings, the sensor's set-up.

    Raises:
        DriverError: A device does not answer.
        InputError: The masks do not fit on the modulator.
    """
    table = rig.table
    modulator, sensor = devices.modulator.connect(), devices.sensor.connect()
    largest = max(sensor.formats, key=lambda fmt: fmt.height * fmt.width)
    size = (table.sensor.height or largest.height, table.sensor.width or largest.width)
    codes = draw_codes(table.capture, size, rig.folder)
    masks = on_modulator(codes, table.registration, (modulator.height, modulator.width))
    config = SensorConfig(
        height=size[0],
        width=size[1],
        fourcc=table.sensor.format.strip(),
        gain_db=table.sensor.gain_db,
        buffers=table.sensor.buffers,
        warm_up_frames=table.sensor.warm_up_frames,
        controls=table.sensor.controls,
        top=table.sensor.top,
        left=table.sensor.left,
    )
    return codes, _settings(rig, masks), config


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
        ring=capture.ring,
        travel=travel,
        margin_s=capture.margin_s,
        jitter_s=capture.jitter_s,
        retries=capture.retries,
        optics=_optics(rig),
    )
