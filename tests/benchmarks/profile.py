"""The time of a reconstruction by stage, kernel and iteration of the fit, and at the begin and end of the command.

    python -m tests.benchmarks profile

One simulated exposure is reconstructed by a preset, `GS2CI_PRESET` (standard), at `GS2CI_SIZE` (264x352), every kernel
on one thread. What each part of it
costs the processor is counted by the clock of the thread that runs it, without what the parts inside it cost. Then one
fit alone is timed on one and on two threads: the additional time of two threads is their synchronisation. At the end,
fresh processes measure the cost of imports, and the writing of the run folder that of report and pictures.
"""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numba

from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.evaluate import run_folder
from gs2ci.reconstruct import observe, pipeline
from gs2ci.reconstruct.fit.coarse import exposure
from gs2ci.reconstruct.fit.coarse import stage as coarse
from gs2ci.reconstruct.fit.coarse import state as coarse_state
from gs2ci.reconstruct.fit.coarse.looks import Looks
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.density import gathering
from gs2ci.reconstruct.fit.losses import objective as losses
from gs2ci.reconstruct.fit.optimiser import gaussians as optimiser
from gs2ci.reconstruct.fit.optimiser import poses
from gs2ci.reconstruct.fit.surfaces import surfaces
from gs2ci.reconstruct.hypotheses import fitting
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.cpu import backend, function, lists, passes, stopping
from tests.stability.benches import Bench

SCENE = "motorcycle"
SIZE = tuple(int(side) for side in os.environ.get("GS2CI_SIZE", "264x352").split("x"))
PRESET = os.environ.get("GS2CI_PRESET", "standard")
ONE_FIT_ITERATIONS = 150
IMPORTED = ("gs2ci.cli", "gs2ci.reconstruct.pipeline", "gs2ci.evaluate.run_folder")

PARTS: tuple[tuple[str, Any, str], ...] = (
    ("registration", observe, "register"),
    ("first look: decode, path, depth", observe, "look"),
    ("first look: decode, path, depth", observe, "look_closer"),
    ("order of depth", fitting.Fits, "order_of"),
    ("first Gaussians", fitting.Fits, "beginning"),
    ("mean of the fits", fitting, "combined"),
    ("choice of views", pipeline, "hand_over"),
    ("record", pipeline, "record"),
    ("fit: loop", coarse.CoarseRun, "advance"),
    ("fit: looks at held-out pixels", Looks, "take"),
    ("fit: sweeps for surfaces", exposure, "find_surfaces"),
    ("fit: density rule", coarse_state.FitState, "densify"),
    ("fit: error blended back", gathering.Gathering, "_most_blended"),
    ("iteration: loss", losses.DataTerm, "value_and_gradient"),
    ("iteration: opacity term", coarse_state, "add_regularisers"),
    ("iteration: surfaces' term", surfaces.Surfaces, "draw"),
    ("iteration: what joins these", coarse_state.FitState, "backward"),
    ("iteration: finite scene", optimiser.GaussianOptimiser, "scene_is_finite"),
    ("iteration: finite gradient", optimiser.GaussianOptimiser, "gradient_is_finite"),
    ("iteration: Gaussians' step", optimiser.GaussianOptimiser, "step"),
    ("iteration: poses' step", poses.PoseCorrections, "step"),
    ("iteration: gradient by poses", poses.PoseCorrections, "pull"),
    ("rendering: checks of input", backend, "check_rendering"),
    ("rendering: checks of masks", backend, "check_masks"),
    ("kernel: project", passes, "project"),
    ("kernel: spans of Gaussians", lists, "count_entries"),
    ("kernel: lists of cells", lists, "fill_entries"),
    ("kernel: blend", passes, "blend"),
    ("kernel: gradient of blend", passes, "differentiate_blend"),
    ("kernel: gradient of project", passes, "differentiate_project"),
    ("kernel: coded sum", function, "cells_to_coded"),
    ("kernel: gradient of coded sum", function, "coded_gradient_to_cells"),
    ("kernel: views", function, "cells_to_views"),
    ("kernel: gradient of views", function, "view_gradients_to_cells"),
    ("kernel: stopped light", stopping, "_stop_light"),
    ("depth of each Gaussian", backend, "depth_fields"),
)


class Clock:
    """Counts the processor seconds of parts, each without the parts that it calls."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        self._inside = threading.local()
        self._lock = threading.Lock()

    def counted(self, name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(work)
        def run(*args: Any, **kwargs: Any) -> Any:
            stack = self._inside.__dict__.setdefault("stack", [])
            stack.append(0.0)
            began_s = time.thread_time()
            try:
                return work(*args, **kwargs)
            finally:
                took_s = time.thread_time() - began_s
                own_s = took_s - stack.pop()
                if stack:
                    stack[-1] += took_s
                with self._lock:
                    self.seconds[name] += own_s
                    self.calls[name] += 1

        return run


@contextmanager
def counting(clock: Clock) -> Iterator[None]:
    patches = [patch.object(owner, name, clock.counted(part, getattr(owner, name))) for part, owner, name in PARTS]
    for each in patches:
        each.start()
    try:
        yield
    finally:
        for each in reversed(patches):
            each.stop()


def run() -> None:
    shot = Bench(scene=SCENE).expose(SIZE)
    threads = numba.get_num_threads()
    _one_fit(shot, 10)  # compiles
    try:
        numba.set_num_threads(1)
        found = _print_parts(shot)
        for count in sorted({1, min(2, threads)}):
            numba.set_num_threads(count)
            wall_s, processor_s = _one_fit(shot, ONE_FIT_ITERATIONS)
            print(
                f"one fit of {ONE_FIT_ITERATIONS} iterations, {count} threads: {wall_s:.2f} s, CPU {processor_s:.2f} s"
            )
    finally:
        numba.set_num_threads(threads)
    _print_ends(shot, found)


def _print_parts(shot: Shot) -> pipeline.Reconstruction:
    clock = Clock()
    before_s, before_wall_s = time.process_time(), time.perf_counter()
    with counting(clock):
        found = pipeline.reconstruct(shot, preset(PRESET))  # type: ignore[arg-type]
    total_s, wall_s = time.process_time() - before_s, time.perf_counter() - before_wall_s
    iterations = clock.calls["iteration: Gaussians' step"]
    print(
        f"{SCENE}, {SIZE[0]} x {SIZE[1]} x {len(shot.masks)}, {PRESET}: CPU {total_s:.1f} s, {wall_s:.1f} s, "
        f"{iterations} iterations of both fits, {found.result.gaussians} Gaussians\n"
        f"{'part':36} {'calls':>6} {'CPU s':>7} {'share':>6} {'ms a call':>10} {'ms an iteration':>16}"
    )
    for name in sorted(clock.seconds, key=lambda part: -clock.seconds[part]):
        seconds, calls = clock.seconds[name], clock.calls[name]
        print(
            f"{name:36} {calls:6} {seconds:7.2f} {seconds / total_s:6.1%} {1e3 * seconds / calls:10.2f} "
            f"{1e3 * seconds / iterations:16.2f}"
        )
    rest_s = total_s - sum(clock.seconds.values())
    print(f"{'what is left':36} {'':6} {rest_s:7.2f} {rest_s / total_s:6.1%}", flush=True)
    return found


def _one_fit(shot: Shot, iterations: int) -> tuple[float, float]:
    """Return the wall and processor seconds of one fit alone."""
    fit = replace(Settings().fit, iterations=iterations, hold_out=HoldOut(patience=iterations), surfaces=None)
    taken: list[tuple[float, float]] = []
    plain = fitting.advance_together

    def timed(*given: Any, **how: Any) -> Any:
        wall_s, processor_s = time.perf_counter(), time.process_time()
        result = plain(*given, **how)
        taken.append((time.perf_counter() - wall_s, time.process_time() - processor_s))
        return result

    with patch.object(fitting, "advance_together", timed):
        pipeline.reconstruct(shot, Settings(fit=fit, fits=1, look_again=False), Silent())
    return sum(wall_s for wall_s, _ in taken), sum(processor_s for _, processor_s in taken)


def _print_ends(shot: Shot, found: pipeline.Reconstruction) -> None:
    for module in IMPORTED:
        seconds = [_process_seconds(f"import {module}") for _ in range(3)]
        print(f"a process that imports {module}: CPU {min(seconds):.2f} s")
    with tempfile.TemporaryDirectory() as folder:
        before_s = time.process_time()
        run_folder.write_run(Path(folder) / "run", shot, found.result, found.scene)
        print(f"the run folder: CPU {time.process_time() - before_s:.2f} s")


def _process_seconds(program: str) -> float:
    before = os.times()
    subprocess.run([sys.executable, "-c", program], check=True)
    after = os.times()
    return after.children_user - before.children_user + after.children_system - before.children_system
