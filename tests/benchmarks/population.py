"""The number of Gaussians over the iterations of preset `paper`, and of interpretations of the paper that diverged.

    GS2CI_SIZE="48 64" GS2CI_SEED=1 GS2CI_READINGS="paper,adc" python -m tests.benchmarks population

Prints a line every 500 iterations: the reading, the iteration, the population, the loss, and what an iteration took of
the processor since the line before. A reading ends at iteration
7,500, or at its memory guard. The scene is small; even so a reading takes minutes, so what is printed can be cut short.
Without variables: 48 x 64 px, masks and noise by seed 1, all readings.
"""

import os
import time
from dataclasses import replace
from typing import Final

from gs2ci.core.errors import ResourceError
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.density.classic import Classic
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.paper.density.rules import adc
from gs2ci.reconstruct.paper.preset import paper_settings
from gs2ci.reconstruct.pipeline import reconstruct
from tests.tables.cases import Case

_UNTIL: Final = 7_500
_EVERY: Final = 500
# Four times what the paper's rule reaches at 48 x 64 px: enough to tell.
_MOST_PER_PIXEL: Final = 36_000 / (48 * 64)


class _Enough(Exception):  # noqa: N818 - the end of a reading, not an error
    """The last iteration that is looked at is done."""


class _Counter(Silent):
    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name
        self._since_s = time.process_time()

    def step(self, done: int, **figures: float | int | str) -> None:
        """Print the population every so often."""
        if "gaussians" not in figures or done % _EVERY:
            return
        now_s = time.process_time()
        took_ms, self._since_s = 1e3 * (now_s - self._since_s) / _EVERY, now_s
        print(f"{self._name:22} {done:6} {figures['gaussians']:8} {figures['loss']:.4f} {took_ms:6.1f}", flush=True)
        if done >= _UNTIL:
            raise _Enough


def _readings(most: int) -> dict[str, CoarseSettings]:
    paper = replace(paper_settings().fit, most_gaussians=most)
    assert isinstance(paper.density, Osgr)
    return {
        "paper": paper,
        "comparable gradients": replace(paper, comparable_gradients=True),
        "removal at 0.005": replace(paper, density=replace(paper.density, criteria=Classic())),
        "budget after others": replace(paper, density=replace(paper.density, ranked_first=False)),
        "no opacity splits": replace(paper, density=replace(paper.density, opacity_splits=False)),
        "adc": replace(paper, density=adc(Classic.of_nerfstudio()), loss=replace(paper.loss, opacity=0.0)),
        "before": replace(paper, comparable_gradients=True, density=Osgr()),
    }


def run() -> None:
    """Fit with each reading, and print."""
    height, width = (int(side) for side in os.environ.get("GS2CI_SIZE", "48 64").split())
    readings = _readings(round(_MOST_PER_PIXEL * height * width))
    wanted = [name for name in os.environ.get("GS2CI_READINGS", "").split(",") if name] or list(readings)
    unknown = set(wanted) - set(readings)
    if unknown:
        raise SystemExit(f"GS2CI_READINGS names {', '.join(sorted(unknown))}; there are {', '.join(readings)}")
    shot = Case("boxes", scene="boxes", size=(height, width)).shot(int(os.environ.get("GS2CI_SEED", "1")))
    print(f"{'reading':22} {'after':>6} {'count':>8} loss   ms an iteration")
    for name in wanted:
        fit = readings[name]
        try:
            reconstruct(shot, replace(paper_settings(), fit=fit), _Counter(name))
        except _Enough:
            continue
        except ResourceError as error:
            print(f"{name:22} ends: {error.problem}", flush=True)
