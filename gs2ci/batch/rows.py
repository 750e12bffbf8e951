"""The result of an exposure: a small JSON file each in `rows/`, and one CSV of all.

Here: `Row`, its file, `write_csv`. Not here: where the figures come from (`work`), the page (`index_page`).
"""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from gs2ci.core.errors import Gs2ciError
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.report import Report

ROWS_NAME: Final = "rows"
CSV_NAME: Final = "runs.csv"

State = Literal["done", "failed", "lost"]


class RowProblem(BaseModel):
    """Why an exposure has no run: the error's class and text."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: str
    problem: str
    allowed: str = ""
    remedy: str = ""
    trace: str = ""

    @classmethod
    def of(cls, error: BaseException, trace: str = "") -> "RowProblem":
        """Make it from an error."""
        kind = type(error).__name__
        if isinstance(error, Gs2ciError):
            return cls(kind=kind, problem=error.problem, allowed=error.allowed, remedy=error.remedy)
        return cls(kind=kind, problem=str(error) or kind, trace=trace)


class Row(BaseModel):
    """How one exposure ended.

    `done`: its run folder exists. `failed`: it cannot be reconstructed, `problem` says why. `lost`: all workers that
    processed it died. Figures are those of its report: None without a truth, or without a run.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    state: State
    file: str
    index: int
    key: str
    verdict: str | None = None
    views: int | None = None
    height: int | None = None
    width: int | None = None
    psnr_db: float | None = None
    ssim: float | None = None
    nate: float | None = None
    path_error_expected: float | None = None
    heldout_rms: float | None = None
    residual_rms: float | None = None
    gaussians: int | None = None
    doubts: int | None = None
    seconds: float | None = None
    peak_mib: float | None = None
    machine: str = ""
    problem: RowProblem | None = None


def row_of(name: str, file: Path, index: int, key: str, report: Report, *, machine: str) -> Row:
    """Return the row of a finished run, with its report's figures."""
    psnr, ssim, trajectory, geometry = report.psnr_db, report.ssim, report.trajectory, report.geometry
    return Row(
        name=name,
        state="done",
        file=str(file),
        index=index,
        key=key,
        verdict=report.verdict,
        views=report.views,
        height=report.size[0],
        width=report.size[1],
        psnr_db=None if psnr is None else psnr.mean,
        ssim=None if ssim is None else ssim.mean,
        nate=None if trajectory is None else trajectory.nate,
        path_error_expected=None if geometry is None else geometry.path_error_expected,
        heldout_rms=report.heldout_rms,
        residual_rms=report.residual.rms,
        gaussians=report.gaussians,
        doubts=sum(note.kind.weight != "remark" for note in report.notes),
        seconds=report.seconds["total"],
        peak_mib=report.peak_mib,
        machine=machine,
    )


def read_row(output: Path, name: str) -> Row | None:
    """Return the row of an exposure; None if there is none or it cannot be read: the exposure is then done again."""
    try:
        return Row.model_validate_json(_place(output, name).read_bytes())
    except (OSError, ValidationError):
        return None


def write_row(output: Path, row: Row) -> None:
    """Store a row; its file appears completely or not at all.

    Raises:
        StorageError: The disk refuses.
    """
    write_whole(_place(output, row.name), row.model_dump_json(indent=1) + "\n", parents=True)


def remove_row(output: Path, name: str) -> None:
    """Remove the row of an exposure, if there is one.

    Raises:
        OSError: The disk refuses.
    """
    _place(output, name).unlink(missing_ok=True)


def _place(output: Path, name: str) -> Path:
    return output / ROWS_NAME / f"{name}.json"


def read_rows(output: Path) -> list[Row]:
    """Return every row that a folder of runs holds, by name."""
    names = sorted(path.stem for path in (output / ROWS_NAME).glob("*.json"))
    return [row for name in names if (row := read_row(output, name)) is not None]


def write_csv(output: Path, rows: Sequence[Row]) -> Path:
    """Write all rows as one CSV, with an empty cell for a missing figure; return its path.

    Raises:
        StorageError: The disk refuses.
    """
    columns = [name for name in Row.model_fields if name not in ("key", "problem")]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*columns, "error", "message"])
    for row in rows:
        problem = row.problem
        said = ("", "") if problem is None else (problem.kind, problem.problem)
        writer.writerow(["" if (cell := getattr(row, name)) is None else cell for name in columns] + list(said))
    return write_whole(output / CSV_NAME, text.getvalue(), parents=True)
