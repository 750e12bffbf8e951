"""The cases of tables: simulated scenes, the files of a folder, or simulated benches, in a requested size.

Not here: what a case is (`cases`), which table takes which (`catalogue`).
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from gs2ci.core.errors import InputError
from tests.tables.beside import tells_beside
from tests.tables.calibration import BENCHES
from tests.tables.cases import Case

SIMULATED: Final = ("boxes", "thicket", "motorcycle", "corridor")
TEXTURELESS: Final = "textureless"
_READ: Final = (".npz", ".mat", ".h5")


def simulated_cases() -> tuple[Case, ...]:
    """Return cases with scenes of the simulator's library, exposed by its light path."""
    return tuple(Case(name, scene=name) for name in SIMULATED)


def condition_cases(folder: Path | None) -> tuple[Case, ...]:
    """Return the measurements of a folder, or simulated ones; these include a scene that is hard by itself.

    Raises:
        InputError: The folder holds none.
    """
    if folder is not None:
        return file_cases(folder)
    easy = simulated_cases()
    return (*easy, replace(easy[0], name=TEXTURELESS, scene=TEXTURELESS))


def measurements(folder: Path | None) -> tuple[Case, ...]:
    """Return the measurements of a folder, or simulated ones without it.

    Raises:
        InputError: The folder holds none.
    """
    return simulated_cases() if folder is None else file_cases(folder)


def mechanism_cases(folder: Path | None) -> tuple[Case, ...]:
    """Return cases on which no mechanism was made: simulated scenes, some in hard conditions, and a folder's files.

    Raises:
        InputError: The folder holds none.
    """
    names = (*SIMULATED, "ball", "planes", TEXTURELESS, "moving")
    easy = tuple(Case(name, scene=name) for name in names)
    hard = (
        Case("boxes, 2 % noise", scene="boxes", noise=0.02),
        Case("thicket, focal unknown", scene="thicket", focal_known=False),
        Case("ball, stage off 5 %", scene="ball", stage_off=0.05),
        Case("corridor, 16 views", scene="corridor", views=16, stopped_down=True),
        Case("motorcycle, grey", scene="motorcycle", grey_masks=True),
    )
    return (*easy, *hard, *(() if folder is None else file_cases(folder, _READ)))


def file_cases(folder: Path, endings: tuple[str, ...] = (".npz",)) -> tuple[Case, ...]:
    """Return a case for each measurement's file of a folder, by the endings of their names.

    Raises:
        InputError: The folder holds none.
    """
    files = sorted(file for file in folder.glob("*") if file.suffix in endings and not tells_beside(file))
    if not files:
        raise InputError(
            f"{folder} holds no {' or '.join(endings)} file",
            remedy="name a folder of measurements, or leave --data out",
        )
    return tuple(Case(file.stem, file=str(file.resolve())) for file in files)


def bench_cases(_folder: Path | None) -> tuple[Case, ...]:
    """Return a case for each simulated bench that is calibrated, with its name alone; a folder is not used."""
    return tuple(Case(name) for name in BENCHES)


def resized(cases: Sequence[Case], size: tuple[int, int]) -> tuple[Case, ...]:
    """Return the cases in another size: scenes are rendered in it, files are cropped to their middle.

    Args:
        cases: Measurements.
        size: Height and width, px.

    Raises:
        InputError: A side is less than 1 px.
    """
    if min(size) < 1:
        raise InputError(f"size {size[0]} x {size[1]} px", allowed="sides of at least 1 px")
    return tuple(replace(case, size=size) for case in cases)
