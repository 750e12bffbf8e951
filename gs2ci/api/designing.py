"""Which masks, travel and number of exposures serve a bench and a kind of scene best: `design`.

Here: the order of the work: candidates, what the bench can take, what their coding tells, checks, files. Not here: any
of these (`gs2ci.rig.design`, `gs2ci.evaluate.design`).
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from gs2ci.api.display import shown
from gs2ci.api.options import check_choice, check_number, check_seed, check_whole
from gs2ci.core.durations import parse_duration_s, spoken_duration
from gs2ci.core.errors import Gs2ciError, InputError, StorageError
from gs2ci.core.progress import Progress
from gs2ci.core.whole_file import check_place, write_whole
from gs2ci.reconstruct.choices import PresetName

if TYPE_CHECKING:
    from gs2ci.evaluate.design.pages import Design, DesignRow
    from gs2ci.rig.config import CaptureTable, RigTable
    from gs2ci.rig.design.candidates import NotTried, Possible
    from gs2ci.rig.design.exposing import SmallBench
    from gs2ci.rig.design.telling import WantedViews

# Height of the small picture if none is given; its width is in proportion.
_HEIGHT_PX: Final = 72
_LEAST_SIDE, _MOST_SIDE = 32, 512


@dataclass(frozen=True)
class DesignFound:
    """Which capture serves best.

    Args:
        found: All candidates with their figures; `found.chosen` is that of the rig file.
        text: The same in words and as a table, markdown.
        rig_file: The rig file that was written.
        pages: JSON, CSV and picture beside it.
    """

    found: "Design"
    text: str
    rig_file: Path
    pages: list[Path] = field(default_factory=list)

    def _repr_markdown_(self) -> str:
        return self.text


def design(
    rig: str | Path,
    output: str | Path = "designed.toml",
    *,
    scene: str,
    capture: str | None = None,
    computing: str | None = None,
    masks: Sequence[int] = (),
    open_share: Sequence[float] = (),
    element: Sequence[int] = (),
    travel_mm: Sequence[float] = (),
    exposures: Sequence[int] = (),
    wanted_mm: float | None = None,
    checks: int = 4,
    preset: PresetName = "draft",
    size: tuple[int, int] | None = None,
    seed: int = 42,
    overwrite: bool = False,
    command: str = "",
    progress: Progress | None = None,
) -> DesignFound:
    """Find which masks, travel and number of exposures serve a bench and a kind of scene best; nothing is opened.

    Each candidate is judged by what its coding tells of a simulated scene, in a small picture, without a
    reconstruction; the best are then reconstructed, and of three or more the better half once more, under other
    masks. An exposure takes as long as the rig file's own, so that more masks have less light each. Candidates that the
    bench cannot take are left out, each with its reason.

    Args:
        rig: The rig file (TOML) of a bench, real or simulated.
        output: The rig file to write, which takes the best; its JSON, CSV and picture lie beside it.
        scene: The kind of scene: a name of the simulator's library, as boxes or corridor, or a scene file (.toml).
        capture: The longest time of capture, as 10s: uploads, sweeps and masks of all exposures.
        computing: The longest time of computing, as 5min, at the size of the bench's picture on this machine.
        masks: Numbers of masks to try; by default half, once and twice the rig file's.
        open_share: Open shares of the masks to try; by default 0.125, 0.25 and 0.5.
        element: Sensor pixels per side of the masks' elements to try; by default 1 and 2.
        travel_mm: Travels of the camera to try; by default half, once and twice the rig file's.
        exposures: Numbers of exposures of one path, each under masks of its own, to try; by default 1, 2 and 4.
        wanted_mm: Along how much of the path views of the scene are wanted, by which quality is judged; by default the
            rig file's travel.
        checks: How many of the best candidates are reconstructed; 0: none.
        preset: Of these reconstructions: draft or standard.
        size: Height and width of the small picture in px; by default 72 rows.
        seed: Of masks, noise and reconstructions.
        overwrite: Replace the files of an earlier design.
        command: The command that repeats this, for the record.
        progress: Receives the candidates and the checks.

    Raises:
        InputError: A value cannot be used, the rig file says too little of a real bench, or no candidate is left.
        StorageError: A file exists or cannot be written.

    Example:
        >>> gs2ci.design("rig.toml", scene="boxes", masks=[0])
        Traceback (most recent call last):
        gs2ci.core.errors.InputError: --masks 0; ...
    """
    check_seed(seed)
    check_whole("--checks", checks, 0, remedy="leave --checks out for the usual number")
    check_number("--wanted-mm", wanted_mm, above=0, remedy="leave --wanted-mm out for the rig file's travel")
    check_choice("--preset", preset, ("draft", "standard"))
    capture_s = None if capture is None else parse_duration_s(capture)
    computing_s = None if computing is None else parse_duration_s(computing)
    rig, places = Path(rig), _places(Path(output), overwrite=overwrite)
    from gs2ci.rig.config import read_rig
    from gs2ci.rig.design.candidates import Asked, NotTried, Varied

    table, text = read_rig(rig)
    candidates = Varied(masks, open_share, element, travel_mm, exposures).candidates(table)
    if computing_s is not None and not checks:
        raise InputError("--computing with --checks 0", allowed="one check or more: they tell how long computing takes")
    work = _Work.of(table, scene, size, wanted_mm, preset, seed, computing_s)
    from gs2ci.evaluate.design.pages import Design, as_csv, markdown, picture, record
    from gs2ci.rig.design.rewriting import with_capture

    with shown(progress) as display:
        display.stage("candidates", len(candidates))
        rows: list[DesignRow] = []
        possible: dict[int, Possible] = {}
        for done, one in enumerate(Asked(table, capture_s).of(candidates), 1):
            rows.append(work.row(one))
            if not isinstance(one, NotTried):
                possible[len(rows) - 1] = one
            display.step(done)
        if not possible:
            raise InputError(
                f"none of {len(candidates)} candidates is possible, the first because of: {rows[0].left_out}",
                remedy="vary other values, or allow more time",
            )
        rows = work.checked(rows, possible, checks, display)
    rows = _with_front(rows)
    best = possible[next(number for number, row in enumerate(rows) if row.chosen)]
    made = with_capture(text, _numbers(table.capture, best))
    commands = _commands(places[0], best.candidate.exposures)
    found = Design(table.name, work.bench.scene.name, work.size, preset, tuple(rows), str(places[0]), commands, command)
    contents: tuple[str | bytes, ...] = (made, record(found), as_csv(found), picture(found))
    for place, content in zip(places, contents, strict=True):
        write_whole(place, content, parents=True)
    return DesignFound(found, markdown(found), places[0], list(places[1:]))


def _places(output: Path, *, overwrite: bool) -> list[Path]:
    """Return where rig file, JSON, CSV and picture will lie.

    Raises:
        InputError: The output is no .toml file.
        StorageError: One of them is there, or cannot be written.
    """
    if output.suffix != ".toml":
        raise InputError(f"{output} for a rig file", allowed="a name that ends in .toml", remedy="choose one with -o")
    places = [output.with_suffix(ending) for ending in (".toml", ".json", ".csv", ".png")]
    for place in places:
        if place.exists() and not overwrite:
            raise StorageError(
                f"{place} exists", remedy="choose another name with -o, or add --overwrite to replace it"
            )
    check_place(output)
    return places


def _numbers(own: "CaptureTable", best: "Possible") -> dict[str, int | float]:
    """Return the numbers of [capture] that a chosen candidate changes."""
    chosen = best.capture.model_copy(update={"shots": best.candidate.exposures})
    keys = ("masks", "density", "element", "mask_s", "from_mm", "to_mm", "shots", "burst", "turn_masks")
    return {key: getattr(chosen, key) for key in keys if getattr(chosen, key) != getattr(own, key)}


def _commands(rig_file: Path, exposures: int) -> tuple[str, ...]:
    """Return what takes the exposures and reconstructs them."""
    together = " --together" if exposures > 1 else ""
    rig = shlex.quote(str(rig_file))
    return (f"gs2ci capture --rig {rig} -o shot.h5", f"gs2ci reconstruct shot.h5{together} -o run/")


def _with_front(rows: "list[DesignRow]") -> "list[DesignRow]":
    """Mark the candidates that no other beats in time of capture, time of computing and foreseen quality together."""
    from gs2ci.evaluate.design.pages import unbeaten

    tried = [number for number, row in enumerate(rows) if not row.left_out]
    figures = [(rows[n].capture_s or 0.0, rows[n].computing_s or 0.0, rows[n].foreseen_db or 0.0) for n in tried]
    marks = dict(zip(tried, unbeaten(figures), strict=True))
    return [replace(row, unbeaten=marks.get(number, False)) for number, row in enumerate(rows)]


@dataclass(frozen=True, eq=False)
class _Work:
    """A bench before a scene, and what is asked of it.

    Args:
        bench: With a small picture.
        wanted: The views that are wanted.
        preset: Of the checks.
        seed: Of their draws.
        computing_s: The longest time of computing; None: any.
        full_px: Pixels of the bench's own picture.
    """

    bench: "SmallBench"
    wanted: "WantedViews"
    preset: PresetName
    seed: int
    computing_s: float | None
    full_px: int

    @classmethod
    def of(
        cls,
        table: "RigTable",
        scene: str,
        size: tuple[int, int] | None,
        wanted_mm: float | None,
        preset: PresetName,
        seed: int,
        computing_s: float | None,
    ) -> "_Work":
        """Put the bench before the scene."""
        from gs2ci.rig.design.exposing import full_size, small_bench
        from gs2ci.rig.design.telling import wanted_views

        full = full_size(table)
        small = size or (_HEIGHT_PX, round(_HEIGHT_PX * full[1] / full[0]))
        if not all(_LEAST_SIDE <= side <= _MOST_SIDE for side in small):
            raise InputError(
                f"a small picture of {small[0]} x {small[1]} px",
                allowed=f"{_LEAST_SIDE} to {_MOST_SIDE} on each side",
                remedy="give --size HEIGHT WIDTH",
            )
        bench = small_bench(table, scene, small)
        wanted = wanted_views(bench, table.capture, wanted_mm)
        return cls(bench, wanted, preset, seed, computing_s, full[0] * full[1])

    @property
    def size(self) -> tuple[int, int]:
        """Get the size of the small picture."""
        return self.bench.scene.size

    def row(self, one: "Possible | NotTried") -> "DesignRow":
        """Judge a candidate by what its coding tells."""
        from gs2ci.evaluate.design.pages import DesignRow
        from gs2ci.rig.design.candidates import NotTried
        from gs2ci.rig.design.telling import readings_of, told

        of = one.candidate
        row = DesignRow(of.masks, of.density, of.element, of.travel_mm, of.exposures)
        if isinstance(one, NotTried):
            return replace(row, left_out=one.reason)
        found = told(self.bench, self.wanted, readings_of(self.bench, one.capture, of.exposures))
        parts = (_db(part) for part in (found.texture, found.depth, found.unseen, found.decoded))
        texture_db, depth_db, unseen_db, decoded_db = parts
        return replace(
            row,
            mask_s=one.capture.mask_s,
            capture_s=one.capture_s,
            foreseen_db=found.psnr_db,
            texture_db=texture_db,
            depth_db=depth_db,
            unseen_db=unseen_db,
            decoded_db=decoded_db,
            saturated=found.saturated,
        )

    def checked(
        self, rows: "list[DesignRow]", possible: "dict[int, Possible]", checks: int, display: Progress
    ) -> "list[DesignRow]":
        """Reconstruct the best candidates, the better half of them once more, and choose the best.

        Raises:
            InputError: None can be reconstructed in time.
        """
        rows = list(rows)
        tried: list[int] = []
        waiting = sorted(possible, key=lambda number: -(rows[number].foreseen_db or 0.0))
        display.stage("checks", checks + (checks + 1) // 2 if checks > 2 else checks)
        pace_s: float | None = None
        done = 0
        while waiting and len(tried) < max(checks, 1):
            number = waiting.pop(0)
            if not checks:
                tried.append(number)
                break
            if self._is_late(possible[number], pace_s):
                continue
            rows[number], pace_s = self._check(rows[number], possible[number], 0, pace_s)
            done += 1
            display.step(done)
            if not rows[number].left_out and not self._is_late(possible[number], pace_s):
                tried.append(number)
        rows = self._timed(rows, possible, pace_s)
        if not tried:
            first = next(row for row in rows if row.left_out)
            raise InputError(f"no candidate is left, the best because of: {first.left_out}", remedy="allow more time")
        better = sorted(tried, key=lambda number: -(rows[number].quality_db or 0.0))[: (len(tried) + 1) // 2]
        for number in better if len(better) > 1 else ():
            rows[number], _ = self._check(rows[number], possible[number], 1, pace_s)
            done += 1
            display.step(done)
        good = [number for number in better if not rows[number].left_out] or better
        best = max(good, key=lambda number: rows[number].quality_db or 0.0)
        rows[best] = replace(rows[best], chosen=True, left_out="")
        return rows

    def _check(
        self, row: "DesignRow", of: "Possible", again: int, pace_s: float | None
    ) -> "tuple[DesignRow, float | None]":
        """Reconstruct a candidate's exposures; return its row, and the pace of computing."""
        from gs2ci.evaluate.design.checking import checked, mean_db, pace
        from gs2ci.evaluate.novel_views import NovelViews

        count = of.candidate.exposures
        try:
            # Checked once more, they have other masks.
            capture = of.capture.model_copy(update={"seed": of.capture.seed + again})
            shots = [self.bench.expose(capture, index) for index in range(count)]
            wanted = NovelViews(self.wanted.views, self.wanted.poses)
            found = checked(shots, wanted, self.bench.scene.intrinsics, self.preset, self.seed + again)
        except Gs2ciError as error:
            return replace(row, left_out=f"its reconstruction failed: {error}"), pace_s
        known = [] if row.checked_db is None or row.views_db is None else [(row.checked_db, row.views_db)]
        both = [*known, (found.psnr_db, found.views_db)]
        views_db = mean_db([views for _, views in both])
        row = replace(row, checked_db=mean_db([scene for scene, _ in both]), views_db=views_db, checks=row.checks + 1)
        took = pace(found.seconds, of.candidate.masks, count, self.size[0] * self.size[1])
        return row, took if pace_s is None else pace_s

    def _expected_s(self, of: "Possible", pace_s: float) -> float:
        from gs2ci.evaluate.design.checking import expected_seconds

        return expected_seconds(pace_s, of.candidate.masks, of.candidate.exposures, self.full_px)

    def _is_late(self, of: "Possible", pace_s: float | None) -> bool:
        """Tell whether computing would take longer than is allowed, as far as that is known."""
        known = pace_s is not None and self.computing_s is not None
        return known and self._expected_s(of, pace_s or 0.0) > (self.computing_s or 0.0)

    def _timed(
        self, rows: "list[DesignRow]", possible: "dict[int, Possible]", pace_s: float | None
    ) -> "list[DesignRow]":
        """Say how long the computing of each candidate takes; those that take too long are left out."""
        if pace_s is None:
            return rows
        rows = list(rows)
        for number, of in possible.items():
            late = (
                f"more than {spoken_duration(self.computing_s or 0.0)} of computing"
                if self._is_late(of, pace_s)
                else ""
            )
            rows[number] = replace(
                rows[number], computing_s=self._expected_s(of, pace_s), left_out=rows[number].left_out or late
            )
        return rows


def _db(power: float) -> float:
    return float(-10 * np.log10(max(power, 1e-12)))
