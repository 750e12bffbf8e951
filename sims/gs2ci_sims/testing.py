"""The laws that every simulated effect keeps, for tests of an effect of one's own.

Here: `check_effect`, on small signals of each stage. Not here: whether its bound is one, which needs its physics
(`tests/sims/effects/test_bounds.py` shows how).
"""

import math
from typing import Any

import numpy as np

from gs2ci_sims.effects.base import Effect, LightStage
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import View

_SIZE = (12, 16)


def check_effect(effect: Effect, rig: RigFigures | None = None) -> None:
    """Hold an effect to the laws that the light path rests on.

    It is a frozen dataclass; it leaves its argument alone, gives the same for the same draws, and stays finite.

    Args:
        effect: Acting on views, masks, photons, electrons or readings.
        rig: With whose figures.

    Raises:
        AssertionError: It breaks one of them.
        NotImplementedError: It acts on times or paths, for which there is no small signal here.
    """
    frozen = getattr(getattr(type(effect), "__dataclass_params__", None), "frozen", False)
    assert frozen, f"{type(effect).__name__} is a frozen dataclass of its parameters"
    assert math.isfinite(effect.cost_ns), "cost_ns is finite"
    assert effect.cost_ns >= 0, "cost_ns is 0 or more"
    signal = _signal(effect.stage)
    before = _numbers(signal).copy()
    first, second = (effect.apply(signal, rig or RigFigures(), np.random.default_rng(1)) for _ in range(2))
    assert np.array_equal(_numbers(signal), before), "its argument is left alone"
    assert np.array_equal(_numbers(first), _numbers(second)), "the same draws give the same"
    assert np.isfinite(_numbers(first)).all(), "what comes out is finite"
    assert _numbers(first).shape == before.shape, "what comes out is as large as what went in"


def _signal(stage: LightStage) -> Any:
    draws = np.random.default_rng(0)
    if stage is LightStage.RADIANCE:
        height, width = _SIZE
        intrinsics = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
        return View(draws.random((*_SIZE, 3)), intrinsics, 0, 1 + draws.random(_SIZE))
    shapes = {
        LightStage.MASKS: (4, *_SIZE),
        LightStage.PHOTONS: (*_SIZE, 3),
        LightStage.CHARGE: (*_SIZE, 1),
        LightStage.READOUT: (*_SIZE, 1),
    }
    if stage not in shapes:
        raise NotImplementedError(f"no small signal for {stage}")
    top = 1.0 if stage is LightStage.MASKS else 1000.0
    return top * draws.random(shapes[stage])


def _numbers(signal: Any) -> Any:
    return signal.radiance if isinstance(signal, View) else np.asarray(signal)
