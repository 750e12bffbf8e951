"""The record of a trade-off for the page of a run: `tradeoff.json`, schema `gs2ci.tradeoff/1`.

Here: the record, its writing, and its reading as untrusted input. Not here: making it of trials (`pages.py`), its
section (`gs2ci.evaluate.pages.tradeoff_section`).

The sentences are stored as text, so that a page made years later needs neither the solver nor the trials' version.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from gs2ci.core.errors import StorageError
from gs2ci.core.json_text import as_json, first_fault, parse_json
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.environment import Machine
from gs2ci.evaluate.wording import UNKNOWN

Measure = Literal["psnr_db", "heldout_db"]

SCHEMA: Final = "gs2ci.tradeoff/1"
RECORD_NAME: Final = "tradeoff.json"
TITLES: Final[dict[Measure, str]] = {"psnr_db": "PSNR, dB", "heldout_db": "held-out pixels, dB"}
HEADINGS: Final = ("", "s", "PSNR, dB", "SSIM", "nATE", "held-out, dB", "iterations", "Gaussians")
# A record takes some ten thousand bytes.
LIMIT_BYTES: Final = 2**20
# Far beyond any figure of a trial; axes with larger values could overflow.
LARGEST: Final = 1e12
LEAST_S: Final = 1e-6

_Figure = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
_Count = Annotated[int, Field(ge=0, le=LARGEST)]
_CHECKED: Final = ConfigDict(strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Tried:
    """One trial and its figures; None if they are not known.

    Args:
        trial: Its name.
        knob: What it changes.
        seconds: From the measurement to the views.
        psnr_db: Against the truth.
        ssim: Against the truth.
        nate: Error of the camera path.
        heldout_db: By pixels of the measurement that no trial saw.
        iterations: Iterations of the fit.
        gaussians: Number of Gaussians at its end.
        unbeaten: Whether no other is both quicker and better.
        exposures: How many were reconstructed together; None if the trial is of one alone.
        capture_s: Their seconds of capture.
    """

    __pydantic_config__ = _CHECKED

    trial: str
    knob: str
    seconds: Annotated[float, Field(ge=LEAST_S, le=LARGEST)]
    psnr_db: _Figure | None
    ssim: _Figure | None
    nate: _Figure | None
    heldout_db: _Figure | None
    iterations: _Count
    gaussians: _Count
    unbeaten: bool
    exposures: _Count | None = None
    capture_s: Annotated[float, Field(ge=0, le=LARGEST)] | None = None

    @property
    def cells(self) -> tuple[str, ...]:
        """Get the figures as they stand under `HEADINGS`, the name left out."""
        figures = ((self.psnr_db, 2), (self.ssim, 4), (self.nate, 4), (self.heldout_db, 2))
        shown = [UNKNOWN if figure is None else f"{figure:.{digits}f}" for figure, digits in figures]
        return (f"{self.seconds:.1f}", *shown, f"{self.iterations}", f"{self.gaussians}")


@dataclass(frozen=True)
class TradeoffRecord:
    """Accuracy against time, for one shot on one machine.

    Args:
        name: Name of the shot.
        measure: The measure by which trials are compared; None if their quality is not known.
        sentences: The results in words.
        trials: Those that succeeded, in their order.
        command: The command that repeats this.
        machine: The machine on which the trials ran.
        versions: Versions of the programs.
    """

    __pydantic_config__ = _CHECKED

    name: str
    measure: Measure | None
    sentences: tuple[str, ...]
    trials: tuple[Tried, ...]
    command: str
    machine: Machine
    versions: Mapping[str, str]


_RECORDS: Final = TypeAdapter(TradeoffRecord)


def write_record(folder: Path, record: TradeoffRecord) -> Path:
    """Write the record into a folder, completely or not at all; return its path.

    Raises:
        StorageError: The disk refuses.
    """
    text = as_json({"schema": SCHEMA, **asdict(record)})
    return write_whole(Path(folder) / RECORD_NAME, text)


def read_record(folder: Path) -> TradeoffRecord | None:
    """Read the record of a folder, or None if it has none.

    Raises:
        StorageError: It is truncated, too large, of another schema, or its values are invalid.
    """
    path = Path(folder) / RECORD_NAME
    if not path.exists():
        return None
    try:
        if path.stat().st_size > LIMIT_BYTES:
            raise ValueError(f"it has {path.stat().st_size} bytes, more than {LIMIT_BYTES}")
        text = path.read_text(encoding="utf-8")
        found = parse_json(text)["schema"]
        if found != SCHEMA:
            raise ValueError(f"it has schema {found!r}")
        return _RECORDS.validate_json(text)
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = first_fault(error) if isinstance(error, ValidationError) else f"{type(error).__name__}: {error}"
        raise StorageError(
            f"{path} cannot be read: {why}",
            allowed=f"what `gs2ci tradeoff --report` writes, schema {SCHEMA}",
            remedy="delete it, or run `gs2ci tradeoff` again",
        ) from error
