"""The page of a run, `run/report.html`: verdict first, then the pictures, then the details of the run.

Here: its sections and their contents. Not here: the parts of sections (`pieces.py`), what to try next
(`next_steps.py`), reading the folder (`run_evidence.py`).
"""

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from markupsafe import Markup

from gs2ci.core.durations import spoken_duration
from gs2ci.core.findings import Code
from gs2ci.core.whole_file import check_earlier, write_whole
from gs2ci.evaluate.pages import pieces
from gs2ci.evaluate.pages.camera_path import Paths, path_colour, path_svg
from gs2ci.evaluate.pages.charts import Bar, Chart, Colour, Line
from gs2ci.evaluate.pages.frame import PAGE_MARK, PageSection, page, piece
from gs2ci.evaluate.pages.next_steps import next_steps, outcome
from gs2ci.evaluate.pages.pieces import FigureOfMerit
from gs2ci.evaluate.pages.run_evidence import FinishedRun, read_run
from gs2ci.evaluate.pages.run_pictures import RunPictures, collect_pictures
from gs2ci.evaluate.pages.scene_view import scene_view
from gs2ci.evaluate.pages.tradeoff_section import tradeoff_section
from gs2ci.evaluate.report import Report, Scores, Simulation
from gs2ci.evaluate.summary import summary_rows
from gs2ci.evaluate.sureness import DEPTH_OTHER, SURE_OF_DEPTH, SURE_OF_VIEWS
from gs2ci.evaluate.tradeoff.record import RECORD_NAME, TradeoffRecord, read_record
from gs2ci.evaluate.wording import describe_number, describe_value, flat_rows, spoken_rows
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.ply import read_ply

PAGE_NAME: Final = "report.html"
FILES: Final = (
    ("report.json", "every figure of this page and more"),
    ("views.npy, views/", "the recovered views, exact and as pictures"),
    ("scene.ply", "the Gaussians as they were fitted; for viewers: gs2ci export --to ply"),
    ("motion.npy, displacement.npy, motion.png", "if things move: the motion of each Gaussian and each pixel"),
    ("moments/", "if requested with --moments: pictures spread over the exposure"),
    ("cameras.json, colmap/", "the cameras, for nerfstudio and COLMAP"),
    ("depth.npy", "distance along the optical axis, in the unit of the path"),
    ("views_error.npy, depth_error.npy", "standard errors, pixel by pixel"),
    ("disagreement.npy", "difference between several fits, full scale 1"),
    ("decode.npy, scene_views.npy", "the two candidates: the decode without a scene, and the scene alone"),
    ("overview.png", "the run in one picture"),
)


def write_run_page(folder: Path, destination: Path | None = None) -> Path:
    """Build the page of a run folder and write it; return its path.

    Args:
        folder: A run folder.
        destination: The page's file, where only an earlier page is replaced; `report.html` in the folder if None.

    Raises:
        StorageError: The folder is no complete run of this version, its record of a trade-off is damaged, another file
            lies at the destination, or the disk refuses.
        InputError: Its scene.ply is damaged.
    """
    if destination is not None:
        check_earlier(destination, PAGE_MARK, "a page")
    place = Path(folder) / "scene.ply"
    scene = read_ply(place) if place.is_file() else None
    text = run_page(read_run(folder), read_record(folder), scene)
    return write_whole(Path(folder) / PAGE_NAME if destination is None else destination, text)


def run_page(evidence: FinishedRun, tradeoff: TradeoffRecord | None = None, scene: Gaussians | None = None) -> str:
    """Build the page of a run.

    Args:
        evidence: The contents of its folder.
        tradeoff: Accuracy against time for its shot, if `gs2ci tradeoff --report` has added it.
        scene: Its Gaussians, for the interactive view on the page; None leaves that out.
    """
    report = evidence.report
    pictures = collect_pictures(evidence)
    first = [
        PageSection("Views", _views(report, pictures), _views_lead(pictures)),
        PageSection("Scene and cameras", _scene(evidence, scene, pictures)),
        PageSection("View by view", _per_view(report)),
        PageSection("Depth, error, disagreement", _maps(pictures)),
        PageSection("How sure it is", _sureness(report, pictures), _sureness_lead(report)),
        PageSection("What moves", _motion(evidence), _motion_lead(report)),
        PageSection("Camera path", _path(evidence, pictures.indices), _path_lead(evidence)),
        PageSection("Exposures", _exposures(report), "One scene, and the views and the path of each exposure."),
        PageSection("Quality against time", _curve(report) + _race(report), report.stopped.sentence),
        PageSection("Cost", _cost(report)),
    ]
    if tradeoff is not None:
        first.append(tradeoff_section(tradeoff))
    if report.simulation is not None:
        first.append(
            PageSection("Simulated effects", _simulation(report.simulation), _simulation_lead(report.simulation))
        )
    files = FILES if tradeoff is None else (*FILES, (RECORD_NAME, "accuracy against time, the figures"))
    last = [
        PageSection("Notes and doubts", _notes(report)),
        PageSection("Measurement and calibration", _measurement(report)),
        PageSection("Settings", pieces.facts([*flat_rows(report.settings), ("seed", report.seed)]), folded=True),
        PageSection("Environment", _environment(report), folded=True),
        PageSection("Files", pieces.facts(files), "Other files in this run's folder."),
    ]
    shown = [section for section in (*first, *last) if section.body]
    return page(report.name, shown, masthead=_masthead(report), eyebrow=f"{report.name} · gs2ci run")


def _notes(report: Report) -> Markup:
    told = [note.advice for note in report.notes]
    return pieces.sentences(told, empty="There is nothing to doubt or to add.")


def _masthead(report: Report) -> Markup:
    out = outcome(report)
    top = pieces.masthead(out.headline, _how_good(report), _figures(report), out.tone, out.word)
    return top + pieces.steps(
        next_steps(report), title="What to try next", empty="Nothing in this run's evidence asks for a change."
    )


def _how_good(report: Report) -> list[str]:
    """Return sentences on the quality and its evidence."""
    said = []
    if report.psnr_db is not None and report.decode.psnr_db is not None:
        mean, decode = report.psnr_db.mean, report.decode.psnr_db.mean
        gain = mean - decode
        compared = f"{gain:.1f} dB better than the decode alone" if gain >= 0.05 else "as good as the decode alone"
        said.append(f"Against the true views: {mean:.1f} dB, {compared}.")
    own, others = report.heldout_rms, report.residual.heldout_rms.decode
    if own is not None and others is not None and report.verdict != "decode":
        said.append(
            f"On the held-out pixels, which no stage has used, the residual of the prediction is {own:.3f} of a view's "
            f"full scale; that of the decode is {others:.3f}."
        )
    said.append(_where_from(report))
    return said


def _where_from(report: Report) -> str:
    """Return from which stage the views are, and how far several fits agree on them."""
    if report.verdict == "scene":
        return "The views are rendered from the scene."
    if report.verdict == "decode":
        return "The views are those of the decode: its residual on the held-out pixels is smaller than the scene's."
    combined = (note.figures.get("decode") for note in report.notes if note.kind is Code.VIEWS_COMBINED)
    shares = [share for share in combined if isinstance(share, float)]
    share = sum(shares) / max(1, len(shares))
    if share > 0.5:
        return (
            f"The views are mostly those of the decode ({share:.0%}): the scene explains the held-out pixels less well."
        )
    ensemble = report.ensemble
    if ensemble is None or ensemble.averaged == 1 or ensemble.spread is None:
        return "The views are rendered from the scene and refined by its residual."
    return (
        f"The views are the mean of {ensemble.averaged} fits, refined by its residual; the fits differ from the mean "
        f"by {ensemble.spread:.3f} of a view's full scale. The scene is that of the best fit."
    )


def _figures(report: Report) -> list[FigureOfMerit]:
    """Return the most important figures: the summary's, without what only completes another."""
    judged = report.heldout_rms is not None
    rest = ("rotation", "residual") if judged else ("rotation",)
    rows = [row for row in summary_rows(report) if row[0] not in rest]
    # A unit stays on the line of its number.
    return [
        FigureOfMerit(value, name, re.sub(r"(?<=\d) (?=s\b|MiB)", "\u00a0", remark)) for name, value, remark in rows
    ]


def _views(report: Report, pictures: RunPictures) -> Markup:
    return piece(
        "comparator",
        layers=pictures.layers,
        recovered=pictures.recovered,
        measurement=pictures.measurement,
        captions=[_caption(report, index) for index in pictures.indices],
        width=pictures.recovered[0].width,
        height=pictures.recovered[0].height,
        pixelated=pictures.pixelated,
        **pictures.numbered,
    )


def _scene(evidence: FinishedRun, scene: Gaussians | None, pictures: RunPictures) -> Markup:
    if scene is None:
        return Markup()
    height, width = evidence.views.shape[1:3]
    alone = next((layer.pictures for layer in pictures.layers if layer.name == "scene"), None) or pictures.recovered
    still = alone[len(alone) // 2]
    return scene_view(scene, evidence.world_to_camera, evidence.intrinsics, (height, width), still)


def _views_lead(pictures: RunPictures) -> str:
    few = "" if pictures.all_shown else f"{len(pictures.indices)} of {pictures.count} views are shown here. "
    return f"{few}Pictures on this page are compressed; views.npy holds the exact numbers."


def _caption(report: Report, index: int) -> str:
    if report.psnr_db is None or report.decode.psnr_db is None:
        return ""
    decode, own = report.decode.psnr_db.per_view[index], report.psnr_db.per_view[index]
    return f"decode {decode:.2f} dB, recovered {own:.2f} dB"


def _per_view(report: Report) -> Markup:
    if report.psnr_db is None or report.views < 2:
        return Markup()
    views = list(range(1, report.views + 1))
    lines = [Line("recovered", views, report.psnr_db.per_view, "accent")]
    # If one of these two is the result, it is already drawn.
    others: tuple[tuple[str, Scores, str, Colour], ...] = (
        ("scene", report.scene, "scene alone", "third"),
        ("decode", report.decode, "decode", "muted"),
    )
    for key, scores, name, colour in others:
        if report.verdict != key and scores.psnr_db is not None:
            lines.append(Line(name, views, scores.psnr_db.per_view, colour, dashed=True))
    return pieces.chart(
        Chart(lines, "view, in order of exposure", "PSNR, dB", "PSNR of each view: recovered, scene alone and decode")
    )


def _maps(pictures: RunPictures) -> Markup:
    shown = [
        piece(
            "by_view",
            pictures=found.pictures,
            label=found.label,
            caption=found.caption,
            scale=found,
            pixelated=pictures.pixelated,
            **pictures.numbered,
        )
        for name in ("depth", "error", "disagreement")
        if (found := pictures.maps.get(name)) is not None
    ]
    if not shown:
        return pieces.paragraph("No depth was found, the true views are not known, and there was one fit.")
    return pieces.columns(*shown) + piece("picker", label="View", **pictures.numbered)


def _sureness(report: Report, pictures: RunPictures) -> Markup:
    found = report.sureness
    if found is None:
        return Markup()
    shown = [
        piece("veiled", map=pictures.maps[name], pixelated=pictures.pixelated, **pictures.numbered)
        for name in ("views_error", "depth_error")
        if name in pictures.maps
    ]
    rows: list[tuple[str, str]] = [
        ("standard error of the views' values, mean", describe_number(found.views_mean, 2)),
        (f"of them surer than {SURE_OF_VIEWS:g}", f"{found.views_sure_share:.0%}"),
    ]
    if found.depth_median is not None and found.depth_sure_share is not None:
        rows += [
            ("standard error of depth, median", f"{found.depth_median:.1%}"),
            (f"pixels whose depth is surer than {SURE_OF_DEPTH:.0%}", f"{found.depth_sure_share:.0%}"),
        ]
    if found.positions is not None and found.rotations_deg is not None:
        rows += [
            (
                "standard error of cameras' places, largest",
                f"{describe_number(max(found.positions), 2)} {report.length_unit}",
            ),
            ("of their rotations against each other, largest", f"{describe_number(max(found.rotations_deg), 2)}°"),
        ]
    return pieces.columns(*shown) + piece("picker", label="View", **pictures.numbered) + pieces.facts(rows)


def _sureness_lead(report: Report) -> str:
    lead = "Of the errors, about 68 % lie within one standard error and 95 % within two; their tails are long."
    if report.sureness is None or report.sureness.depth_median is None:
        return lead
    if not report.found(Code.DEPTH_ORDER_OPEN):
        return lead
    return (
        f"{lead} The order of near and far is open, and with it depth and path are one of two: their errors are not "
        f"normally distributed, and the standard errors hold only if the order is the one taken. "
        f"{DEPTH_OTHER} has depth with near and far exchanged."
    )


def _motion(evidence: FinishedRun) -> Markup:
    found = evidence.report.motion
    if found is None or not (found.tried or found.moves):
        return Markup()
    drawn = evidence.motion_picture
    picture = Markup() if drawn is None else pieces.figure(drawn, "what moves, and how fast")
    rows = [(name, describe_number(rms)) for name, rms in found.heldout_rms.items()]
    return picture + (pieces.table(["fits", "rms on held-out pixels"], rows) if rows else Markup())


def _motion_lead(report: Report) -> str:
    found = report.motion
    if found is None or not (found.tried or found.moves):
        return ""
    if not found.moves:
        return "Moving scenes were fitted as well and do not explain the measurement better: nothing moves."
    return (
        f"{found.pixels_share or 0:.0%} of the picture moves by itself by half a pixel or more over the exposure, "
        f"{found.median_px or 0:.1f} px in the median."
    )


def _path(evidence: FinishedRun, shown: Sequence[int]) -> Markup:
    report = evidence.report
    paths = Paths(evidence.world_to_camera, evidence.true_world_to_camera, evidence.stage_world_to_camera)
    unit = "true units" if paths.true is not None else "stage units" if paths.stage is not None else "scene units"
    names = [name for name in ("recovered", "true", "stage") if getattr(paths, name) is not None]
    drawing = piece(
        "chart_frame",
        wide=path_svg(paths, 760, unit=unit, shown=shown),
        narrow=path_svg(paths, 340, unit=unit, shown=shown),
        legend=[(name, path_colour(name), "dashed" if name == "stage" else "line") for name in names],
        caption="Seen from above; the cameras look up the page.",
    )
    rows: list[tuple[str, Any, str]] = []
    if (errors := report.trajectory) is not None:
        rows += [
            ("absolute error (ATE), rms", errors.ate, " true units"),
            ("of the path's size (nATE)", errors.nate, ""),
            ("mean rotation error", errors.rotation_deg, "°"),
            ("error per step (RPE), rms", errors.rpe_t, " true units"),
            ("rotation per step (RPE)", errors.rpe_r_deg, "°"),
        ]
    if (geometry := report.geometry) is not None:
        rows += [
            ("poses started from", geometry.method, ""),
            ("lengths in the unit of", geometry.unit_of, ""),
            ("tracked points", geometry.tracks, ""),
            ("reprojection error, rms", geometry.reprojection_rms_px, " px"),
            ("parallax, rms", geometry.parallax_px, " px"),
            ("expected error of the first path, of its size", geometry.path_error_expected, ""),
        ]
    known = [(name, describe_value(value) + mark) for name, value, mark in rows if value is not None]
    return drawing + pieces.facts(known)


def _path_lead(evidence: FinishedRun) -> str:
    if evidence.true_world_to_camera is not None:
        return "The recovered path, aligned with the true one by a similarity, which no image can determine."
    if evidence.stage_world_to_camera is not None:
        return "The recovered path, aligned with the stage's by a similarity, which no image can determine."
    if evidence.report.known_at_rest:
        return "The camera was at rest: there is no path, and what is drawn as depth is not to be relied on."
    if evidence.report.lacks_path:
        return "No path was found: cameras that were taken to be at rest, where the fit has moved them."
    return "The recovered path; its unit is the scene's own."


def _curve(report: Report) -> Markup:
    looks = [look for look in report.curve if look.seconds > 0]
    drawn = []
    wanted: tuple[tuple[str, str, Colour, float | None], ...] = (
        ("psnr_db", "PSNR, dB", "accent", _decode_psnr(report)),
        ("heldout", "held-out residual, rms", "truth", report.residual.heldout_rms.decode),
    )
    for key, label, colour, level in wanted:
        known = [(look.seconds, value) for look in looks if (value := getattr(look, key)) is not None]
        if not known:
            continue
        seconds, values = [at for at, _ in known], [value for _, value in known]
        drawn.append(
            pieces.chart(
                Chart(
                    [Line(label, seconds, values, colour)],
                    "seconds since the beginning",
                    label,
                    f"{label} against seconds: {values[0]:.4g} after {seconds[0]:.0f} s, {values[-1]:.4g} after "
                    f"{seconds[-1]:.0f} s",
                    x_log=True,
                    y_log=key == "heldout" and min(values) > 0,
                    levels=[] if level is None else [("decode", level)],
                )
            )
        )
    return Markup().join(drawn) if drawn else pieces.paragraph("Nothing was fitted, so there is no curve to show.")


def _exposures(report: Report) -> Markup:
    """List what each of several exposures gave."""
    if len(report.exposures) < 2:
        return Markup()

    def said(value: float | None) -> str:
        return "" if value is None else f"{value:.4f}"

    def better(first: int, views: int) -> str:
        known = None if report.psnr_db is None else report.psnr_db.per_view[first : first + views]
        return "" if not known else f"{sum(known) / len(known):.2f}"

    rows = [
        [
            one.name,
            f"{one.first_view} to {one.first_view + one.views - 1}",
            one.path,
            said(one.heldout_rms.decode),
            said(one.heldout_rms.scene),
            said(one.heldout_rms.of(one.verdict)),
            better(one.first_view, one.views),
            "" if one.seen_alone is None else f"{100 * one.seen_alone:.0f} %",
        ]
        for one in report.exposures
    ]
    headings = (
        *("exposure", "views", "path from", "residual of the decode", "of the scene", "of the views", "PSNR, dB"),
        "seen by it alone",
    )
    shown = [number for number in range(len(headings)) if any(row[number] for row in rows)]
    return pieces.table([headings[number] for number in shown], [[row[number] for number in shown] for row in rows])


def _race(report: Report) -> Markup:
    """Show who led when, and what became of each hypothesis."""
    colours: tuple[Colour, ...] = ("accent", "truth", "third", "fourth", "fifth", "muted")
    raced = [entry for entry in report.race if entry.heldout]
    if len(raced) < 2:
        return Markup()
    lines = [
        Line(
            f"{number + 1} {entry.hypothesis}",
            [iteration for iteration, _ in entry.heldout],
            [rms for _, rms in entry.heldout],
            colours[number % len(colours)],
        )
        for number, entry in enumerate(raced)
    ]
    least = min(min(line.y) for line in lines)
    drawn = pieces.chart(
        Chart(
            lines,
            "iterations of each fit",
            "held-out residual, rms",
            f"held-out residual of {len(lines)} hypotheses against the iterations of their fits",
            y_log=least > 0,
        )
    )
    rows = [
        (f"{number + 1} {entry.hypothesis}", entry.path, f"{entry.iterations} of {entry.schedule}", entry.outcome)
        for number, entry in enumerate(report.race)
    ]
    return drawn + pieces.table(("hypothesis", "path", "iterations", "outcome"), rows)


def _decode_psnr(report: Report) -> float | None:
    return None if report.decode.psnr_db is None else report.decode.psnr_db.mean


def _cost(report: Report) -> Markup:
    seconds = report.seconds
    stages = [(name, value) for name, value in seconds.items() if name != "total"]
    rest = seconds["total"] - sum(value for _, value in stages)
    if rest > 0.02 * seconds["total"]:
        stages.append(("other", rest))
    colours: tuple[Colour, ...] = ("fourth", "third", "accent", "fifth", "truth", "muted")
    parts = [
        Bar(name, value, f"{value:.1f} s", colours[index % len(colours)]) for index, (name, value) in enumerate(stages)
    ]
    height, width = report.size
    per_view = 1e6 * seconds["total"] / max(height * width * report.views, 1)
    rows = [
        ("total", spoken_duration(seconds["total"])),
        ("per recovered megapixel", f"{per_view:.0f} s"),
        ("peak memory", f"{report.peak_mib:.0f} MiB"),
    ]
    return pieces.bars(parts, unit="s") + pieces.facts(rows)


def _simulation(plan: Simulation) -> Markup:
    rows = []
    for name, effect in plan.effects.items():
        bound = effect.bound_rms_dn
        at_stake = bound if isinstance(bound, str) else describe_number(bound, 3)
        rows.append((name.replace("_", " "), at_stake, effect.simulated, effect.why, effect.sampling or "–"))
    return pieces.table(("effect", "at stake, DN rms", "simulated", "why", "sampling"), rows)


def _simulation_lead(plan: Simulation) -> str:
    error, tolerance = describe_number(plan.error_dn, 2), describe_number(plan.tolerance_dn, 2)
    return (
        f"This exposure differs from a simulation of every effect by at most {error} DN rms (requested: {tolerance}). "
        f"It uses {describe_number(plan.views)} rendered views. At stake: the change if an effect is left out."
    )


def _measurement(report: Report) -> Markup:
    """Return what was measured and what was known about the bench, only as stated in the file."""
    height, width = report.size
    colours = f"{report.cfa} mosaic" if report.cfa else "RGB" if report.channels == 3 else "mono"
    sources = {"file": "from the file", "estimated": "estimated", "default": "assumed"}
    rows: list[tuple[str, Any]] = [
        ("pixels", f"{width} × {height}, {colours}"),
        ("masks in one exposure" if not report.exposures else "masks in all exposures", report.views),
    ]
    if report.geometry is not None:
        focal = f"{describe_number(report.geometry.focal_px)} px {sources[report.geometry.focal_source]}"
        rows.append(("focal length", focal))
    measured = report.measured
    for share, name in (
        (measured.open_share, "masks open, mean"),
        (measured.grey_share, "samples of masks that are partly open"),
        (measured.closed_share, "pixels that no mask opens"),
        (measured.saturated_share, "saturated pixels"),
    ):
        if share is not None:
            rows.append((name, f"{100 * share:.3g} %"))
    rows.append(("exposure of a mask, share of its interval", "{:.3g} to {:.3g}".format(*measured.weights)))
    rows.append(("stage telemetry", measured.telemetry))
    told = list(spoken_rows(report.provenance))
    origins = piece("on_screen", title="From the shot file", content=pieces.facts(told)) if told else Markup()
    return pieces.facts(rows) + origins


def _environment(report: Report) -> Markup:
    return pieces.columns(
        pieces.facts([*spoken_rows(asdict(report.machine)), ("rendered on", report.device)]),
        pieces.facts(flat_rows(report.versions)),
    )
