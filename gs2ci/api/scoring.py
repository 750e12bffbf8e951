"""A finished run scored and measured: `evaluate`, `measure`. Not here: computing any figure (`gs2ci.evaluate`)."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from gs2ci.api.options import as_path, check_number, check_whole
from gs2ci.api.runs import FOLDER_REMEDY, Run
from gs2ci.api.shots import every_exposure, load
from gs2ci.core.arrays import F32, on_host
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot

if TYPE_CHECKING:
    from gs2ci.evaluate.measuring import Length
    from gs2ci.evaluate.pages.run_evidence import FinishedRun

# Larger than for any sensor; their squares and quotients remain finite.
READ_NOISE_RANGE: Final = (1e-9, 1e3)
ELECTRONS_RANGE: Final = (1e-3, 1e12)
_NOVEL_REMEDY: Final = "save them with np.savez(path, views=..., world_to_camera=...)"


def evaluate(
    run: Run | str | Path,
    shot: Shot | str | Path | Sequence[Shot | str | Path],
    *,
    index: int | None = None,
    depth: Any = None,
    novel: str | Path | None = None,
    read_noise: float | None = None,
    electrons: float | None = None,
    lpips: str | None = None,
) -> dict[str, Any]:
    """Score a saved run against what is known about its shot: truth, noise, other views.

    Args:
        run: A run that was saved, or its folder.
        shot: The shot that was reconstructed, or one of the same measurement that also contains the truth; or a file.
            Of a joint run a list of its exposures, or files of them; those that it left out are passed over.
        index: Which shot of each file; by default the first, and all of them for a joint run.
        depth: True depth along the optical axis, [N, H, W] or its .npy file, in any unit, 0 where unknown.
        novel: True views from other poses, as a pinhole with the shot's camera matrix sees them (undistort them if the
            lens distorts): an .npz file of `views` and `world_to_camera` in the true path's world.
        read_noise: Standard deviation of the sensor in the dark, in full scales of one view, for chi-squared.
        electrons: Electrons of a pixel at the full scale of one view, for the shot noise in chi-squared; if not
            given, shot noise is not included.
        lpips: "lpips" for the model added by `gs2ci models add lpips`, or your own ONNX file.

    Returns:
        The figures as plain values, schema gs2ci.evaluation/2; None if a figure cannot be computed. Of a joint run
        those over all views, and those of each exposure in `exposures`.

    Raises:
        InputError: A value cannot be used, or the shot is of another measurement than the run.
        StorageError: A file cannot be read.

    Example:
        >>> found = gs2ci.evaluate("run", gs2ci.load("measurement.npz", focal_px=40.0))
        >>> found["psnr_db"]["mean"] > 10, found["novel_views"]
        (True, None)
    """
    check_noise(read_noise, electrons)
    if index is not None:
        check_whole("--index", index, 0)
    from gs2ci.core.summed import summed
    from gs2ci.evaluate import evaluation
    from gs2ci.evaluate.evaluation import exposures_of
    from gs2ci.evaluate.metrics import SensorNoise
    from gs2ci.evaluate.novel_views import read_novel_views
    from gs2ci.evaluate.pages.run_evidence import check_same_shot
    from gs2ci.reconstruct.paper import perceptual

    noise = None if read_noise is None else SensorNoise(read_noise, math.inf if electrons is None else electrons)
    finished = finished_run(run)
    report = finished.report
    exposures = exposures_of(report, _measured(shot, index, of_several=bool(report.exposures)))
    whole = exposures[0] if len(exposures) == 1 else summed(exposures, report.name)
    check_same_shot(finished.folder, whole)
    evidence = evaluation.ReferenceData(
        whole,
        None if depth is None else _depth(depth),
        None if novel is None else read_novel_views(as_path(novel, of="a file of novel views", remedy=_NOVEL_REMEDY)),
        noise,
        None if lpips is None else perceptual.load_distance(lpips if lpips == "lpips" else f"lpips:{lpips}"),
        tuple(exposures) if len(exposures) > 1 else (),
    )
    return evaluation.evaluate(finished, evidence)


def _measured(
    given: Shot | str | Path | Sequence[Shot | str | Path], index: int | None, *, of_several: bool
) -> list[Shot]:
    """Return the shots that are meant: one of each file, or all for a run of several if no index says which."""
    every = list(given) if isinstance(given, list | tuple) else [cast(Shot | str | Path, given)]
    if of_several and index is None:
        every = every_exposure(every, together=True)
    return [one.check() if isinstance(one, Shot) else load(one, index=index or 0) for one in every]


def check_noise(read_noise: float | None, electrons: float | None) -> None:
    """Check the sensor's figures.

    Raises:
        InputError: One is out of bounds, or requires another that is not given.
    """
    check_number("--read-noise", read_noise, *READ_NOISE_RANGE, remedy="leave --read-noise out, and χ² with it")
    check_number("--electrons", electrons, *ELECTRONS_RANGE, remedy="leave --electrons out, and shot noise with it")
    if electrons is not None and read_noise is None:
        raise InputError("--electrons without --read-noise", remedy="give both, for χ² per pixel")


def measure(
    run: "Run | FinishedRun | str | Path", one: tuple[int, int], other: tuple[int, int], *, view: int | None = None
) -> "Length":
    """Measure the distance between the points that two pixels of a view show.

    Args:
        run: A run that was saved, or its folder.
        one: A pixel as (column, row), counted from 0 at the upper left.
        other: The other one.
        view: Which view, counted from 1 as on the command line; the middle one if None.

    Returns:
        `length` with its `standard_error` in `unit`, both points and the confidence of each depth.

    Raises:
        InputError: The run has no depth, there is no such view or pixel, or there is no surface.

    Example:
        >>> found = gs2ci.measure("run", (8, 12), (24, 12))
        >>> found.length > 0, found.unit
        (True, 'scene units')
    """
    from gs2ci.evaluate import measuring
    from gs2ci.evaluate.pages.run_evidence import FinishedRun

    finished = run if isinstance(run, FinishedRun) else finished_run(run)
    check_whole("--view", view, 1, finished.report.views)
    chosen = middle_view(finished) if view is None else view
    return measuring.measure(finished, one, other, chosen - 1)


def middle_view(run: "FinishedRun") -> int:
    """Return the number of a run's middle view, counted from 1."""
    return run.report.views // 2 + 1


def finished_run(run: Run | str | Path) -> "FinishedRun":
    """Read a run.

    Raises:
        StorageError: It was not saved, or its folder is damaged.
    """
    from gs2ci.evaluate.pages.run_evidence import read_run

    return read_run(folder_of(run))


def folder_of(run: Run | str | Path) -> Path:
    """Return the folder of a run.

    Raises:
        InputError: It was not saved, or is no path.
    """
    folder = run.folder if isinstance(run, Run) else as_path(run, of="a run folder", remedy=FOLDER_REMEDY)
    if folder is None:
        raise InputError("the run has no folder yet", remedy="call save() first")
    return folder


def _depth(given: Any) -> F32:
    from gs2ci.core.foreign.opening import load_single

    where = given if isinstance(given, str | Path) else "depth"
    depth = load_single(Path(given)).values if isinstance(given, str | Path) else np.asarray(on_host(given))
    if depth.ndim not in (2, 3) or depth.dtype.kind not in "uif":
        raise InputError(
            f"{where} holds no depth but {depth.dtype} of shape {list(depth.shape)}",
            allowed="real numbers of shape [N, H, W], or their .npy file",
        )
    return depth.astype(np.float32)
