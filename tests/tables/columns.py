"""The columns of tables of figures: the figure of a row, its title, its number of decimals.

Not here: the computation of a figure (`works`), which table has which columns (`catalogue`).
"""

from dataclasses import dataclass
from typing import Final

from tests.tables.works import COUNTED_AFTER


@dataclass(frozen=True)
class Measure:
    """One column: the key in a cell's row, its title, decimals, and whether more is better."""

    key: str
    title: str
    digits: int
    more_is_better: bool = True


RECONSTRUCTION: Final = (
    Measure("psnr_db", "PSNR, dB", 2),
    Measure("ssim", "SSIM", 4),
    Measure("scene_psnr_db", "scene alone, dB", 2),
    Measure("between_psnr_db", "between, dB", 2),
    Measure("beyond_psnr_db", "beyond, dB", 2),
    Measure("nate", "nATE", 4, more_is_better=False),
    Measure("depth_rel_percent", "depth off, %", 2, more_is_better=False),
    Measure("depth_rank", "order of depth", 2),
    Measure("seconds", "s", 1, more_is_better=False),
)

POPULATION: Final = (
    *RECONSTRUCTION,
    Measure("gaussians", "Gaussians", 0, more_is_better=False),
    Measure("frames_per_second", "rendered views/s", 1),
)

AGAINST_PAPER: Final = (
    *RECONSTRUCTION[:-1],
    Measure("processor_seconds", "processor s", 0, more_is_better=False),
    Measure("iterations", "iterations", 0),
    *(
        Measure(f"gaussians_after_{iteration}", f"Gaussians after {iteration:,}", 0, more_is_better=False)
        for iteration in COUNTED_AFTER
    ),
    Measure("gaussians", "at the end", 0, more_is_better=False),
    Measure("gaussians_most", "at most", 0, more_is_better=False),
)

MECHANISM: Final = (
    *RECONSTRUCTION[:-1],
    Measure("depth_px", "depth off, px", 3, more_is_better=False),
    Measure("heldout_rms", "held out, rms", 4, more_is_better=False),
    Measure("processor_seconds", "processor s", 1, more_is_better=False),
)

PATH: Final = (
    Measure("ate", "ATE", 5, more_is_better=False),
    Measure("nate", "nATE", 4, more_is_better=False),
    Measure("rpe_t", "RPE_t", 5, more_is_better=False),
    Measure("nrpe_t", "nRPE_t", 4, more_is_better=False),
    Measure("rpe_r_deg", "RPE_r, °", 3, more_is_better=False),
    Measure("translation_mean", "mean off, translation", 5, more_is_better=False),
    Measure("rotation_deg", "mean off, °", 3, more_is_better=False),
)
"""Errors of a camera path, as in the paper's Table VI; lengths in the unit of the true path."""

INITIALISATION: Final = (
    Measure("nate", "nATE", 4, more_is_better=False),
    Measure("depth_rank", "order of depth", 2),
    Measure("rpe_r_deg", "turn between views, °", 3, more_is_better=False),
    Measure("unexplained", "unexplained", 4, more_is_better=False),
    Measure("tracks", "tracks", 0),
    Measure("full", "depth found", 2),
    Measure("seconds", "s", 1, more_is_better=False),
)

CALIBRATION: Final = (
    Measure("mask_error_pct", "mask error, % rms", 3, more_is_better=False),
    Measure("stated_pct", "stated, % rms", 3, more_is_better=False),
    Measure("seconds", "bench s", 1, more_is_better=False),
    Measure("registration_px", "registration, px", 5, more_is_better=False),
    Measure("registration_seconds", "its bench s", 1, more_is_better=False),
)
