"""Which cells make which table, and how its figures are laid out.

Here: `Table`, and the tables by name. Not here: their columns (`columns`) and cases (`case_sets`), the work (`works`),
pages (`pages`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.baselines.field_fit import FieldSettings
from gs2ci.tables.calibration import FRAMES, calibrate_masks
from gs2ci.tables.case_sets import bench_cases, condition_cases, measurements, resized
from gs2ci.tables.cases import Case
from gs2ci.tables.cells import Cell
from gs2ci.tables.columns import (
    AGAINST_PAPER,
    CALIBRATION,
    INITIALISATION,
    PATH,
    POPULATION,
    RECONSTRUCTION,
    Measure,
)
from gs2ci.tables.literature import DECODERS, FIELD, LEARNED, decode_case, field_case, model_files
from gs2ci.tables.names import TableName
from gs2ci.tables.simulation import EVERYTHING, TOLERANCES_DN, rig_cases, simulate_rig
from gs2ci.tables.variants import ABLATION, GEOMETRY, ON_PAPERS_SCHEDULE, PAPER, RULES, VARIANTS
from gs2ci.tables.works import initialise_case, reconstruct_case
from gs2ci_sims.scenes.files import scene_names

RATIOS: Final = (0.1, 0.25, 0.5, 0.75, 0.9)
VIEWS: Final = (4, 8, 16, 24, 32)
# Ways in which the paper's Tables IV and V compare each of their lines; where they are named.
_RIVALS: Final = ("one fit", *RULES, *PAPER, *ON_PAPERS_SCHEDULE)
# Fields of a `Case`, against the case untouched. Where more light would reach the sensor, the lens is stopped down:
# else the line would show what clipped readings cost (of 32 views, up to half of all).
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
    """One cell and where its figures go: one line of one case's table; seeds share a line."""

    case: str
    line: str
    cell: Cell


@dataclass(frozen=True)
class TableOptions:
    """What a table is made of.

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
        title: Over the page.
        about: What is compared, in a sentence or two.
        entries: Its cells, from the options.
        measures: Its columns; the first is drawn.
        known: The cases there are: from a folder, or of our own without one.
        axis: What lines that begin with a number are drawn against, on logarithmic axes; "" draws them side by side.
        takes_data: Whether its cases may be the files of a folder.
        takes_size: Whether its cases are measurements, which may be had at another size.
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
    """Return the cases of a table that are wanted, all that it has without any; a library scene may be named besides.

    Args:
        name: Of the table.
        folder: See `known_cases`.
        size: See `known_cases`.
        wanted: Names of cases.

    Raises:
        InputError: As of `known_cases`; or there is no case of a name.
    """
    known = known_cases(name, folder, size)
    others = scene_names() if any(case.scene for case in known) else ()
    named = {case.name: case for case in (*(Case(scene, scene=scene, size=size) for scene in others), *known)}
    unknown = [case for case in wanted if case not in named]
    if unknown:
        raise InputError(f"case {unknown[0]!r} is unknown", allowed=", ".join(named))
    return tuple(named[case] for case in dict.fromkeys(wanted)) or known


def known_cases(name: TableName, folder: Path | None, size: tuple[int, int] | None) -> tuple[Case, ...]:
    """Return the cases that a table has, from a folder or of its own, at their size or another.

    Args:
        name: Of the table.
        folder: Where its files are; None for its own.
        size: Height and width, px; None for their own.

    Raises:
        InputError: The table takes no folder or no size, the folder holds no file of its kind, or a side is no count
            of pixels.
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
    """Make the cell that finds a case's first geometry with a variant of the settings."""
    return replace(reconstruction(case, variant, seed), work=initialise_case)


def _variants(
    names: Sequence[str], cell: Callable[[Case, str, int], Cell] = reconstruction, named: Sequence[str] = ()
) -> Callable[[TableOptions], list[TableEntry]]:
    """Make a line of each of some variants; of further ones only where they are named."""

    def entries(options: TableOptions) -> list[TableEntry]:
        return [
            TableEntry(case.name, name, cell(case, name, seed))
            for case in options.cases
            for name in _chosen(names, options.lines, named)
            for seed in range(options.seeds)
        ]

    return entries


def _of_literature(options: TableOptions) -> list[TableEntry]:
    """Decode or fit by the methods of the literature; those that are slow or need weights only where they are named."""
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
    """Make a line of each changed case by the default way; by other variants («50% open, adc») where they are named."""
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
    """Calibrate masks with more and more frames, and predict them."""
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
    """Return the lines that are wanted, else all but those that are only made where they are named."""
    unknown = [line for line in wanted if line not in lines and line not in named]
    if unknown:
        raise InputError(f"line {unknown[0]!r} is not in this table", allowed=", ".join(map(repr, (*lines, *named))))
    return tuple(wanted or lines)


TABLES: Final[dict[TableName, Table]] = {
    "methods": Table(
        "Methods",
        "The default way, which is the mean of two fits; one fit, and one thing changed at a time in one fit; the "
        "paper's own schedule.",
        _variants(tuple(name for name in VARIANTS if name not in ON_PAPERS_SCHEDULE), named=tuple(ON_PAPERS_SCHEDULE)),
        RECONSTRUCTION,
    ),
    "init": Table(
        "Geometry initialisation",
        "First poses and depth, before any fit: from decoded views and from the paper's proxies. "
        "Unexplained: what the middle view, carried through the geometry and coded, leaves of the measurement.",
        _variants(("default", *GEOMETRY), initialisation),
        INITIALISATION,
    ),
    "density": Table(
        "Density rules",
        "Where Gaussians are added and removed in one fit; all else, the number of iterations included, is the "
        "default's.",
        _variants(("default", "one fit", *RULES), named=(*PAPER, *ON_PAPERS_SCHEDULE)),
        POPULATION,
    ),
    "ablation": Table(
        "Components",
        "One component of the method switched off at a time in one fit, as the paper's Table VII does.",
        _variants(("default", "one fit", *ABLATION)),
        POPULATION,
    ),
    "mask-ratio": Table(
        "Share of open mask pixels",
        "Random binary masks; from files, true views are coded anew. Where more masks are open the lens of a scene is "
        "stopped down, so that no more readings clip.",
        _changed({f"{ratio:.0%} open": {"open_share": ratio, "stopped_down": True} for ratio in RATIOS}, _RIVALS),
        RECONSTRUCTION,
    ),
    "compression": Table(
        "Views in one measurement",
        "As many masks as views, a quarter open. A file's views are thinned, so its compression ends at its own count. "
        "Where more masks are open the lens of a scene is stopped down, so that no more readings clip.",
        _changed(
            {f"{views} views": {"views": views, "open_share": 0.25, "stopped_down": True} for views in VIEWS}, _RIVALS
        ),
        RECONSTRUCTION,
    ),
    "conditions": Table(
        "Hard conditions",
        "The measurement as it is, and with one condition of a real bench at a time: white noise, in shares of one "
        "view's full scale; masks that are more open, or grey; more views of the same path; a lamp that the weights do "
        "not know of; no camera matrix; a stage that tells the path, its places off by a share of its extent. Where "
        "more masks are open the lens is stopped down, so that no more readings clip. New noise, masks "
        "and views code a file's true views anew, without the noise it came with. A line that a case cannot have says "
        "why.",
        _changed(CONDITIONS),
        RECONSTRUCTION,
        condition_cases,
    ),
    "literature": Table(
        "Methods of the literature",
        "The default beside decoders, which give views alone. Only where they are named: `paper`, `paper, fine` and "
        "`scisplat` (ENI, tracks, MCMC), on the paper's 20,000 iterations; `pnp-ffdnet`, `pnp-ffdnet-colour`, "
        "`pnp-fastdvdnet` and `video-decoder`, whose models have to be added (`gs2ci models`); "
        "`field`, a radiance field fitted with its poses as SCINeRF does, which takes many minutes.",
        _of_literature,
        RECONSTRUCTION,
    ),
    "paper": Table(
        "The default and the paper's system",
        "The default beside the system of the paper with its 20,000 iterations: views, novel views, path, depth, and "
        "the population over the iterations. Only where they are named: `paper, fine` with the fine stage, `scisplat` "
        "with SCISplat's choices, and one change to the paper's system at a time.",
        _variants(("default", "paper"), named=(*PAPER, *ON_PAPERS_SCHEDULE)),
        AGAINST_PAPER,
    ),
    "path": Table(
        "Camera paths",
        "All errors of the camera path that the paper's Table VI has, by density rule, in one fit.",
        _variants(("default", "one fit", *RULES), named=(*PAPER, *ON_PAPERS_SCHEDULE)),
        PATH,
    ),
    "seeds": Table(
        "Seeds",
        "The default way under different masks, noise and draws.",
        _variants(("default",)),
        RECONSTRUCTION,
    ),
    "simulate": Table(
        "What accuracy costs the simulator",
        "Planned simulations against simulating everything, with ever more views until the readings settle. «Off» is "
        "the difference before counting and rounding, «bound» what the plan promised; seconds include planning.",
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
        "Masks measured with more and more frames of each, and predicted from a registration with as many; errors "
        "against the truth of simulated benches, time by their own clock, upload included.",
        _calibrations,
        CALIBRATION,
        bench_cases,
        takes_data=False,
        takes_size=False,
    ),
}
