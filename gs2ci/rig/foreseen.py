"""The effects that a simulated bench would simulate in an exposure of its [capture], from the rig file alone.

Here: the exposure as the file lays it out, and the plan of its light; nothing is opened. Not here: taking it
(`recording`), which opens the devices and uses the settings in force; the computation (`gs2ci_sims.planner`).
"""

from typing import Final

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.rig.opening import Rig
from gs2ci.rig.patterns import draw_codes, on_modulator
from gs2ci.rig.simulated import SimulatedBench, build_bench, modulator_size
from gs2ci_drivers.pattern_sequence import PatternSequence
from gs2ci_sims.simulation_plan import Plan
from gs2ci_sims.world import Exposure, MaskInterval

DEFAULT_BITS: Final = 10
"""Bits of the first format that the camera's twin offers."""


def foreseen_plan(rig: Rig, tolerance_dn: float | None = None) -> Plan:
    """Plan the light of the first exposure of a rig file's [capture].

    Args:
        rig: A rig of simulated devices.
        tolerance_dn: Tolerance in total, DN rms; None takes the file's `tolerance_dn` in [world].

    Raises:
        InputError: The devices are real, or the masks do not fit on the modulator.
    """
    table = rig.table
    if table.world is None or not table.simulated:
        raise InputError(
            f"the devices of {table.name!r} are real: there is nothing to simulate",
            allowed='a rig file whose ports are "simulated"',
            remedy="for the plan of its exposure: gs2ci capture --dry-run",
        )
    if tolerance_dn is not None:
        world = table.world.model_copy(update={"tolerance_dn": tolerance_dn})
        table = table.model_copy(update={"world": world})
    bench = build_bench(table)
    assert bench.light is not None  # a bench that is built without another light renders its scene
    return bench.light.foresee(_exposure(Rig(table, rig.text, rig.folder, bench), bench))


def _exposure(rig: Rig, bench: SimulatedBench) -> Exposure:
    """Lay the exposure out as ideal devices would: no latency, a stage at its commanded speed."""
    table, capture, begin_s = rig.table, rig.table.capture, bench.world.clock.now_s()
    world = table.world
    assert world is not None
    size = (table.sensor.height or world.height, table.sensor.width or world.width)
    modulator = modulator_size(table)
    masks = on_modulator(draw_codes(capture, size, rig.folder), table.registration, modulator)
    if capture.mode == "per-mask":
        masks = masks[:1]
    sequence = PatternSequence(masks, capture.bit_depth, capture.mask_s, capture.dark_s)
    windows_s = sequence.windows_s()
    end_s = float(windows_s[-1, 1])
    still = bench.stage.positions_mm_at(begin_s) if bench.stage is not None else {}

    def world_to_camera_at(when_s: float) -> F64:
        share = (when_s - begin_s) / end_s
        along = {capture.axis: capture.from_mm + share * (capture.to_mm - capture.from_mm)} if capture.axis else {}
        return bench.world.mount.world_to_camera({**still, **along})

    top = 2**capture.bit_depth - 1
    shown = zip(masks, windows_s + begin_s, strict=True)
    return Exposure(
        index=0,
        start_s=begin_s,
        end_s=begin_s + end_s - (0.0 if capture.mode == "gate" else capture.margin_s),
        masks=tuple(MaskInterval(mask, top, float(start_s), float(stop_s)) for mask, (start_s, stop_s) in shown),
        world_to_camera_at=world_to_camera_at,
        height=size[0],
        width=size[1],
        bits=table.sensor.bits or DEFAULT_BITS,
    )
