"""Every effect and its bound on random scenes, rigs and masks: does the bound hold, and which share of it is reached?

The masks are drawn from families that cancel, align with the scene or concentrate (`tests.sims.adversaries`). An effect
before the sensor is alone on the rig in every second draw and together with two others in the rest. A draw that exceeds
its bound is measured again with ray tracing: if the image moves by a hundredth of a pixel, the rasteriser's splats
change their order or fall below its threshold, and a pixel jumps. A draw whose lens is refused, since it folds the
picture over, is replaced by another. `GS2CI_DRAWS` sets the number of draws per effect (500), `GS2CI_EFFECTS` names
some effects, separated by commas, `GS2CI_JOBS` sets the number of processes (1). Not here: `bayer_filter`, which cannot
be left out.
"""

import multiprocessing
import os
import time
from typing import Any

import hypothesis.strategies as st
import numpy as np
from hypothesis import HealthCheck, Phase, given, reject, settings

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.stage import StageBacklash
from gs2ci_sims.exact import ExactRenderer
from tests.sims import sensor_family
from tests.sims.adversaries import FAMILIES
from tests.sims.families import FAMILY, Case, ratios, reversing
from tests.sims.sensor_family import SENSOR_FAMILY, look_at, sensor_ratios

DRAWS = int(os.environ.get("GS2CI_DRAWS", "500"))
JOBS = int(os.environ.get("GS2CI_JOBS", "1"))
SCENES = 40
KINDS = {kind.name: kind for kind in (*FAMILY, MotionBlur, *SENSOR_FAMILY)}


def _draw(kind: type[Any], data: st.DataObject) -> tuple[float, float, str]:
    masks = data.draw(st.sampled_from(sorted(FAMILIES)))
    if kind in SENSOR_FAMILY:
        look = look_at(data.draw(st.integers(0, sensor_family.SCENES - 1)), masks)
        effect, rig = data.draw(SENSOR_FAMILY[kind]), data.draw(sensor_family.rigs())
        return *sensor_ratios(look, rig, effect, data.draw(st.integers(0, 99))), masks
    seed = data.draw(st.integers(0, SCENES - 1))
    case = Case(seed, masks)
    if kind is MotionBlur:
        effect, company, options = MotionBlur(15), (), {"sampled": ()}
    else:
        others = [other for other in sorted(FAMILY, key=lambda one: one.name) if other is not kind]
        pair = st.lists(st.sampled_from(others), min_size=2, max_size=2, unique=True)
        company = tuple(data.draw(FAMILY[other](case)) for other in data.draw(st.one_of(st.just([]), pair)))
        effect = data.draw(FAMILY[kind](case))
        options = {"path": reversing(case)} if kind is StageBacklash else {}
    rms, peak = ratios(case, effect, company=company, **options)
    if max(rms, peak) > 1:
        raster = f"{rms:.3f}, {peak:.3f}"
        rms, peak = ratios(case, effect, company=company, renderer=ExactRenderer(), **options)
        print(f"  {raster} by the rasteriser, {rms:.3f}, {peak:.3f} by rays: {effect} with {company},")
        print(f"  case {seed}, {len(case.masks)} {masks} masks")
    return rms, peak, masks


def _measured(kind: type[Any]) -> list[tuple[float, float, str]]:
    found: list[tuple[float, float, str]] = []

    @settings(
        max_examples=DRAWS,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(data=st.data())
    def each(data: st.DataObject) -> None:
        try:
            found.append(_draw(kind, data))
        except InputError as refused:
            if "folds the image over" not in refused.problem:
                raise
            reject()

    each()
    return found


def _row(name: str) -> str:
    began_s = time.process_time()
    found = _measured(KINDS[name])
    rms, peak = (np.array([row[column] for row in found]) for column in (0, 1))
    exceeded = int((np.maximum(rms, peak) > 1).sum())
    return (
        f"| {name} | {len(found)} | {exceeded} | {rms.max():.3f} | {peak.max():.3f} | {np.median(rms):.3f} "
        f"| {found[int(rms.argmax())][2]} | {time.process_time() - began_s:.0f} |"
    )


def run() -> None:
    """Print, per effect, in how many draws the bound was exceeded, what of it was reached, and the processor's time."""
    print("| effect | draws | exceeded | reached, rms | peak | median | with masks | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    wanted = os.environ.get("GS2CI_EFFECTS", "")
    names = [name for name in KINDS if not wanted or name in wanted.split(",")]
    with multiprocessing.get_context("spawn").Pool(JOBS) as pool:
        for row in pool.imap(_row, names):
            print(row, flush=True)
