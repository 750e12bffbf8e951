"""The tables of figures: the cells and the columns of each.

Here: `Table`, and the tables by name. Not here: their columns (`columns`) and cases (`case_sets`), the computation of
a cell (`works`), the output files (`pages`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from gs2ci.core.errors import InputError
from gs2ci_sims.scenes.files import scene_names
from tests.tables.calibration import FRAMES, calibrate_masks
from tests.tables.case_sets import bench_cases, condition_cases, measurements, mechanism_cases, resized
from tests.tables.cases import Case
from tests.tables.cells import Cell
from tests.tables.columns import (
    AGAINST_PAPER,
    CALIBRATION,
    INITIALISATION,
    MECHANISM,
    PATH,
    POPULATION,
    RECONSTRUCTION,
    Measure,
)
from tests.tables.field_fit import FieldSettings
from tests.tables.literature import DECODERS, FIELD, LEARNED, decode_case, field_case, model_files
from tests.tables.names import TableName
from tests.tables.simulation import EVERYTHING, TOLERANCES_DN, rig_cases, simulate_rig
from tests.tables.variants import (
    ABLATION,
    GEOMETRY,
    MECHANISM_LINES,
    MECHANISM_LINES_IN_ONE_FIT,
    ON_PAPERS_SCHEDULE,
    PAPER,
    RULES,
    VARIANTS,
)
from tests.tables.works import initialise_case, reconstruct_case

# Of measurements that show what a mechanism gives: no figure that let one in was made with draws of these.
FRESH_SEED: Final = 5800
RATIOS: Final = (0.1, 0.25, 0.5, 0.75, 0.9)
VIEWS: Final = (4, 8, 16, 24, 32)
# Variants that the paper's Tables IV and V compare on each of their lines; made only if `--lines` names them.
_RIVALS: Final = ("one fit", *RULES, *PAPER, *ON_PAPERS_SCHEDULE)
# Changed fields of a `Case`. If more light would reach the sensor, the lens is stopped down: otherwise the line would
# show the effect of clipped readings (with 32 views, up to half of all).
CONDITIONS: Final[dict[str, dict[str, Any]]] = {
    "as it is": {},
    **{f"noise {percent} %": {"noise": percent / 100} for percent in (1, 2, 5)},
    "half open": {"open_share": 0.5, "stopped_down": True},
    "three quarters open": {"open_share": 0.75, "stopped_down": True},
    "grey masks": {"grey_masks": True},
    **{f"{views} views": {"views": views, "stopped_down": True} for views in (16, 32)},
    **{f"weights off by {percent} %": {"weights_off": percent / 100} for percent in (10, 30)},
    "focal unknown": {"focal_known": False},
    "with a stage": {"stage_off": 0.0},
    **{f"with a stage off by {percent} %": {"stage_off": percent / 100} for percent in (1, 5)},
}


@dataclass(frozen=True)
class TableEntry:
    """A cell with the case and the line in which its figures appear; all seeds share a line."""

    case: str
    line: str
    cell: Cell


@dataclass(frozen=True)
class TableOptions:
    """The choices for a table.

    Args:
        cases: The measurements.
        seeds: How many seeds, from 0 on.
        lines: Only these lines of the table; () takes all.
    """

    cases: tuple[Case, ...]
    seeds: int = 3
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A table of figures.

    Args:
        title: Title of the page.
        about: What is compared, in a sentence or two.
        entries: Returns its cells for the options.
        measures: Its columns; the picture shows the first.
        known: Returns its cases: those of a folder, or the built-in ones without a folder.
        axis: Label of the logarithmic axis for the numbers that lines begin with; "" plots the lines side by side.
        takes_data: Whether its cases may be the files of a folder.
        takes_size: Whether its cases are measurements, whose size can be changed.
    """

    title: str
    about: str
    entries: Callable[[TableOptions], list[TableEntry]]
    measures: tuple[Measure, ...]
    known: Callable[[Path | None], tuple[Case, ...]] = field(default_factory=lambda: measurements)
    axis: str = ""
    takes_data: bool = True
    takes_size: bool = True


def chosen_cases(
    name: TableName, folder: Path | None, size: tuple[int, int] | None, wanted: Sequence[str]
) -> tuple[Case, ...]:
    """Return the named cases of a table, or all of its own without names; any scene of the library may be named.

    Args:
        name: Name of the table.
        folder: See `known_cases`.
        size: See `known_cases`.
        wanted: Names of cases.

    Raises:
        InputError: As in `known_cases`; or a name is not the name of a case.
    """
    known = known_cases(name, folder, size)
    others = scene_names() if any(case.scene for case in known) else ()
    named = {case.name: case for case in (*(Case(scene, scene=scene, size=size) for scene in others), *known)}
    unknown = [case for case in wanted if case not in named]
    if unknown:
        raise InputError(f"case {unknown[0]!r} is unknown", allowed=", ".join(named))
    return tuple(named[case] for case in dict.fromkeys(wanted)) or known


def known_cases(name: TableName, folder: Path | None, size: tuple[int, int] | None) -> tuple[Case, ...]:
    """Return the cases of a table, from a folder or built in, in their own size or in a requested one.

    Args:
        name: Name of the table.
        folder: Folder of its files; None for the built-in cases.
        size: Height and width, px; None for their own.

    Raises:
        InputError: The table takes no folder or no size, the folder holds no suitable file, or a side is less than
            1 px.
    """
    for option, given, takers in (
        ("--data", folder, [other for other, one in TABLES.items() if one.takes_data]),
        ("--size", size, [other for other, one in TABLES.items() if one.takes_size]),
    ):
        if given is not None and name not in takers:
            raise InputError(
                f"{option} for the table {name}",
                allowed=f"for the tables {', '.join(takers)}",
                remedy=f"leave {option} out",
            )
    cases = TABLES[name].known(folder)
    return cases if size is None else resized(cases, size)


def reconstruction(case: Case, variant: str, seed: int) -> Cell:
    """Make the cell that reconstructs a case with a variant of the settings."""
    arguments = {"case": asdict(case), "variant": variant, "seed": seed}
    return Cell(reconstruct_case, arguments, case.files)


def initialisation(case: Case, variant: str, seed: int) -> Cell:
    """Make the cell that estimates a case's first geometry with a variant of the settings."""
    return replace(reconstruction(case, variant, seed), work=initialise_case)


def _variants(
    names: Sequence[str], cell: Callable[[Case, str, int], Cell] = reconstruction, named: Sequence[str] = ()
) -> Callable[[TableOptions], list[TableEntry]]:
    """Make a line for each of the variants `names`; for those in `named` only if the options name them."""

    def entries(options: TableOptions) -> list[TableEntry]:
        return [
            TableEntry(case.name, name, cell(case, name, seed))
            for case in options.cases
            for name in _chosen(names, options.lines, named)
            for seed in range(options.seeds)
        ]

    return entries


def _mechanisms(options: TableOptions) -> list[TableEntry]:
    """Make a line without each mechanism, or without those named, and always the line that it is compared with."""
    named = _chosen(("default", *MECHANISM_LINES), options.lines, ("one fit", *MECHANISM_LINES_IN_ONE_FIT))
    chosen = dict.fromkeys(one for line in named for one in (compared_with(line), line))
    return [
        TableEntry(case.name, line, reconstruction(case, line, FRESH_SEED + seed))
        for case in options.cases
        for line in chosen
        for seed in range(options.seeds)
    ]


def compared_with(line: str) -> str:
    """Return the line of the table of mechanisms that a line is compared with."""
    return "one fit" if line in MECHANISM_LINES_IN_ONE_FIT else "default"


def _of_literature(options: TableOptions) -> list[TableEntry]:
    """Make the lines of the literature's methods; slow ones and those that need weights only if they are named."""
    chosen = _chosen(("default", *DECODERS), options.lines, (*PAPER, *LEARNED, FIELD))
    return [
        TableEntry(case.name, line, _literature(case, line, seed))
        for case in options.cases
        for line in chosen
        for seed in range(options.seeds)
    ]


def _literature(case: Case, line: str, seed: int) -> Cell:
    if line in VARIANTS:
        return reconstruction(case, line, seed)
    files = case.files + model_files(line)
    if line == FIELD:
        arguments = {"case": asdict(case), "iterations": FieldSettings().iterations, "seed": seed}
        return Cell(field_case, arguments, files)
    return Cell(decode_case, {"case": asdict(case), "method": line, "seed": seed}, files)


def _changed(
    lines: Mapping[str, Mapping[str, Any]], variants: Sequence[str] = ()
) -> Callable[[TableOptions], list[TableEntry]]:
    """Make a line for each changed case with the default; with other variants ("50% open, adc") if they are named."""
    ways = {line: (line, "default") for line in lines}
    further = {f"{line}, {variant}": (line, variant) for variant in variants for line in lines}

    def entries(options: TableOptions) -> list[TableEntry]:
        return [
            TableEntry(case.name, name, reconstruction(replace(case, **lines[line]), variant, seed))
            for case in options.cases
            for name in _chosen(tuple(ways), options.lines, tuple(further))
            for line, variant in [(ways | further)[name]]
            for seed in range(options.seeds)
        ]

    return entries


def _tolerances(options: TableOptions) -> list[TableEntry]:
    lines: dict[str, float | None] = {EVERYTHING: None, **{f"{dn:g} DN": dn for dn in TOLERANCES_DN}}
    return [
        TableEntry(case.name, line, _simulation(case, lines[line], seed))
        for case in options.cases
        for seed in range(options.seeds)
        for line in _chosen(tuple(lines), options.lines)
    ]


def _simulation(case: Case, tolerance_dn: float | None, seed: int) -> Cell:
    arguments = {"file": case.file, "tolerance_dn": tolerance_dn, "seed": seed}
    return Cell(simulate_rig, arguments, (case.file,))


def _calibrations(options: TableOptions) -> list[TableEntry]:
    """Measure masks with increasing numbers of frames, and predict them."""
    ways: dict[str, dict[str, int | bool]] = {
        f"measured, {frames} frames": {"frames": frames, "fast": False} for frames in FRAMES
    }
    ways |= {f"predicted, {frames} frames": {"frames": frames, "fast": True} for frames in FRAMES}
    return [
        TableEntry(case.name, line, Cell(calibrate_masks, {"bench": case.name, "seed": seed, **ways[line]}))
        for case in options.cases
        for line in _chosen(tuple(ways), options.lines)
        for seed in range(options.seeds)
    ]


def _chosen(lines: Sequence[str], wanted: Sequence[str], named: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the lines `wanted`, or all of `lines` if none is; lines of `named` are made only if they are wanted."""
    unknown = [line for line in wanted if line not in lines and line not in named]
    if unknown:
        raise InputError(f"line {unknown[0]!r} is not in this table", allowed=", ".join(map(repr, (*lines, *named))))
    return tuple(wanted or lines)


TABLES: Final[dict[TableName, Table]] = {
    "methods": Table(
        "Methods",
        "The default, which is the mean of two fits; one fit; one fit with one change at a time; the paper's own "
        "schedule.",
        _variants(tuple(name for name in VARIANTS if name not in ON_PAPERS_SCHEDULE), named=tuple(ON_PAPERS_SCHEDULE)),
        RECONSTRUCTION,
    ),
    "init": Table(
        "Geometry initialisation",
        "First poses and depth, before any fit: from decoded views and from the paper's proxies. "
        "Unexplained: the residual of the measurement when the middle view is warped to all poses and coded.",
        _variants(("default", *GEOMETRY), initialisation),
        INITIALISATION,
    ),
    "density": Table(
        "Density rules",
        "The rules by which one fit adds and removes Gaussians; all other settings, the number of iterations included, "
        "are the default's.",
        _variants(("default", "one fit", *RULES), named=(*PAPER, *ON_PAPERS_SCHEDULE)),
        POPULATION,
    ),
    "ablation": Table(
        "Components",
        "One component of the method switched off at a time in one fit, as the paper's Table VII does.",
        _variants(("default", "one fit", *ABLATION)),
        POPULATION,
    ),
    "mechanisms": Table(
        "Mechanisms",
        "The default, and the default without one mechanism at a time, on measurements that no mechanism was made on. "
        "Lines in one fit (`one fit, no margin`) are made only if `--lines` names them.",
        _mechanisms,
        MECHANISM,
        mechanism_cases,
    ),
    "mask-ratio": Table(
        "Share of open mask pixels",
        "Random binary masks; the true views of a file are coded again. With a larger open share the lens of a "
        "simulated scene is stopped down, so that no more readings clip.",
        _changed({f"{ratio:.0%} open": {"open_share": ratio, "stopped_down": True} for ratio in RATIOS}, _RIVALS),
        RECONSTRUCTION,
    ),
    "compression": Table(
        "Views in one measurement",
        "As many masks as views, a quarter open. A file's views are subsampled, so lines with more views than it "
        "holds stay empty. With more masks the lens of a simulated scene is stopped down, so that no more readings "
        "clip.",
        _changed(
            {f"{views} views": {"views": views, "open_share": 0.25, "stopped_down": True} for views in VIEWS}, _RIVALS
        ),
        RECONSTRUCTION,
    ),
    "conditions": Table(
        "Hard conditions",
        "The measurement as it is, and with one condition of a real bench at a time: white noise, in percent of one "
        "view's full scale; masks with a larger open share, or grey; more views of the same path; weights that miss "
        "the lamp's flicker; no camera matrix; known stage poses, with position errors in percent of the path's "
        "extent. With more light the lens of a simulated scene is stopped down, so that no more readings clip. For "
        "other noise, masks or views, a file's true views are coded again, without the noise of its own measurement. "
        "A line that is impossible for a case states the reason.",
        _changed(CONDITIONS),
        RECONSTRUCTION,
        condition_cases,
    ),
    "literature": Table(
        "Methods of the literature",
        "The default compared with decoders, which return views but no scene. Further lines are made only if `--lines` "
        "names them: `paper`, `paper, fine` and `scisplat` (ENI, tracks, MCMC), with the paper's 20,000 iterations; "
        "`pnp-ffdnet`, `pnp-ffdnet-colour`, `pnp-fastdvdnet` and `video-decoder`, whose models have to be added first "
        "(`gs2ci models`); `field`, a radiance field fitted together with its poses as in SCINeRF, which takes many "
        "minutes.",
        _of_literature,
        RECONSTRUCTION,
    ),
    "paper": Table(
        "The default and the paper's system",
        "The default compared with the paper's system and its 20,000 iterations: views, novel views, path, depth, and "
        "the number of Gaussians over the iterations. Further lines are made only if `--lines` names them: `paper, "
        "fine` with the fine stage, `scisplat` with SCISplat's choices, and the paper's system with one change at a "
        "time.",
        _variants(("default", "paper"), named=(*PAPER, *ON_PAPERS_SCHEDULE)),
        AGAINST_PAPER,
    ),
    "path": Table(
        "Camera paths",
        "All errors of the camera path in the paper's Table VI, for each density rule, in one fit.",
        _variants(("default", "one fit", *RULES), named=(*PAPER, *ON_PAPERS_SCHEDULE)),
        PATH,
    ),
    "seeds": Table(
        "Seeds",
        "The default with different masks, noise and random draws.",
        _variants(("default",)),
        RECONSTRUCTION,
    ),
    "simulate": Table(
        "What accuracy costs the simulator",
        "Planned simulations compared with a full simulation, whose number of views is increased until its readings "
        "converge. `off` is the difference before photon counting and rounding, `bound` the upper bound that the plan "
        "states; seconds include planning.",
        _tolerances,
        (
            Measure("seconds", "s", 3, more_is_better=False),
            Measure("off_dn", "off, DN rms", 3, more_is_better=False),
            Measure("bound_dn", "bound, DN rms", 3, more_is_better=False),
            Measure("views", "views", 0, more_is_better=False),
            Measure("effects", "effects", 0, more_is_better=False),
            Measure("faster", "times faster than its last round", 1),
            Measure("faster_than_all_rounds", "than all its rounds", 1),
        ),
        rig_cases,
        "tolerance, DN rms in total",
        takes_size=False,
    ),
    "calibrate": Table(
        "What calibrated masks cost",
        "Masks measured with increasing numbers of frames each, and masks predicted from a registration with the same "
        "numbers; errors against the truth of simulated benches, time on the bench's clock, upload included.",
        _calibrations,
        CALIBRATION,
        bench_cases,
        takes_data=False,
        takes_size=False,
    ),
}
