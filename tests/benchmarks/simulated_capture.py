"""Real seconds of a simulated capture, by stage: 8 masks at 400 x 600 on docs/rigs/simulated.toml."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gs2ci.core.progress import Silent
from gs2ci.rig.opening import load_rig
from gs2ci.rig.recording import prepare, record

RIG = Path(__file__).parents[2] / "docs" / "rigs" / "simulated.toml"


class Stopwatch(Silent):
    """A listener that measures stages, and functions it is wrapped around."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds: dict[str, float] = {}
        self._since, self._name = time.perf_counter(), ""

    def stage(self, name: str, total: int | None = None) -> None:
        now = time.perf_counter()
        if self._name:
            self.add(self._name, now - self._since)
        self._since, self._name = now, name

    def add(self, name: str, seconds: float) -> None:
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds

    def around(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.add(name, time.perf_counter() - begin)

        return timed


def _capture(folder: Path) -> tuple[dict[str, float], float, int]:
    watch = Stopwatch()
    begin = time.perf_counter()
    rig = load_rig(RIG)
    watch.add("scene and twins", time.perf_counter() - begin)
    assert rig.bench is not None
    light: Any = rig.bench.world.light
    light.collect = watch.around("of the shots: rendering exposures", light.collect)
    light.truth = watch.around("of the shots: rendering the truth", light.truth)
    devices = rig.open()
    began_s = devices.clock.now_s()
    try:
        prepared = watch.around("connect and plan", prepare)(rig, devices)
        record(rig, devices, prepared, folder / "shot.h5", replace=True, progress=watch)
        watch.stage("")
    finally:
        devices.close()
    return watch.seconds, devices.clock.now_s() - began_s, prepared.plan.settings.shots


def run() -> None:
    """Capture twice, the first time to compile, and print the second."""
    with tempfile.TemporaryDirectory() as folder:
        _capture(Path(folder))
        seconds, virtual_s, shots = _capture(Path(folder))
    for name, took_s in seconds.items():
        print(f"{name:<36} {took_s:6.2f} s")
    whole = sum(took for name, took in seconds.items() if not name.startswith("of the"))
    print(
        f"{'whole simulated capture':<36} {whole:6.2f} s for {shots} shots, {virtual_s:.1f} s on the bench's own clock"
    )
