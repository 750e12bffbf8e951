"""`gs2ci evaluate`: score a finished run against a truth, the sensor's noise, or views from other poses.

Here: the arguments, and the table that is printed. Not here: any figure (`gs2ci.evaluate.evaluation`).
"""

from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api import scoring
from gs2ci.api.derived import with_options_of
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import print_table, say
from gs2ci.commands.reconstruct import chosen_exposures


@with_options_of(scoring.evaluate, without=("run",))
def run(
    folder: Annotated[Path, tyro.conf.Positional],
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    *,
    index: int | str | None = None,
    depth: Path | None = None,
    novel: Path | None = None,
    more: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    json: AsJson = False,
    **options: Any,
) -> Path:
    """Score a finished run against what is known about its shot: truth, noise, other views.

    Args:
        folder: The run folder, as `gs2ci reconstruct` wrote it.
        shot: The shot file that was reconstructed, or one of the same measurement that also contains the truth; of a
            joint run the files of its exposures.
        output: The JSON file to write; by default "evaluation.json" in the run folder. An earlier evaluation is
            replaced, any other file is not.
        index: Which shot of the file; by default the first. Of a joint run, which of each file, 3 or a range such as
            0:8; by default all.
        more: More files of a joint run.
        depth: True depth along the optical axis, a .npy file of [N, H, W] in any unit, 0 where unknown.

    Returns:
        The JSON file.

    Raises:
        Gs2ciError: A file or a value cannot be used, the shot is of another measurement than the run, or another file
            lies where the JSON file is to be written.
    """
    scoring.check_noise(options["read_noise"], options["electrons"])
    from gs2ci.core.storage import read_shot
    from gs2ci.evaluate.evaluation import check_evaluation_place, write_evaluation
    from gs2ci.evaluate.report import read_report
    from gs2ci.evaluate.whole_folder import REPORT_NAME

    output = output or folder / "evaluation.json"
    check_evaluation_place(output)
    # A folder without a report is refused below: first the shot, which is at times given in its place.
    joint = (folder / REPORT_NAME).is_file() and bool(read_report(folder).exposures)
    if more or isinstance(index, str) or joint:
        measured = chosen_exposures((shot, *more), index)
    else:
        measured = [read_shot(shot, index or 0)]
    found = scoring.evaluate(folder, measured, depth=depth, novel=novel, **options)
    written = write_evaluation(output, found)
    with answered(json) as answer:
        print_table((), rows(found))
        exposures, notes = found["exposures"], found["notes"]
        for line in (*map(of_exposure, exposures), *(note["sentence"] for note in notes), written):
            say(line)
        answer(found)
    return written


def of_exposure(found: dict[str, Any]) -> str:
    """Return the figures of one exposure of a joint run in one line."""
    views = f"views {found['first_view'] + 1} to {found['first_view'] + found['views']}"
    said = [f"{found['name']} ({views})"]
    if found["psnr_db"]:
        said += [f"PSNR {found['psnr_db']['mean']:.2f} dB", f"SSIM {found['ssim']['mean']:.4f}"]
    if found["lpips"]:
        said.append(f"LPIPS {found['lpips']['mean']:.4f}")
    if found["depth"]:
        said.append(f"depth error {found['depth']['abs_rel']:.2%}, median {found['depth']['median_rel']:.2%}")
    if found["residual"]:
        said.append(f"residual {found['residual']['rms']:.4f}")
    return "  ".join(said)


def rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """List the known figures, a name and a value each."""
    said = []
    for title, scores in (("", found), ("novel views ", found["novel_views"] or {})):
        if scores.get("psnr_db"):
            said += [(f"{title}PSNR", f"{scores['psnr_db']['mean']:.2f} dB")]
            said += [(f"{title}SSIM", f"{scores['ssim']['mean']:.4f}")]
    if found["lpips"]:
        said.append(("LPIPS", f"{found['lpips']['mean']:.4f}"))
    path = found["trajectory"] or {}
    for key, name, unit in (
        ("ate", "ATE", ""), ("nate", "nATE", ""), ("translation_mean", "translation, mean", ""),
        ("rotation_deg", "rotation, mean", "°"), ("rpe_t", "RPE, translation", ""), ("rpe_r_deg", "RPE, rotation", "°"),
    ):  # fmt: skip
        if path.get(key) is not None:
            said.append((name, f"{path[key]:.4g}{unit}"))
    from gs2ci.evaluate.depth import DepthErrors

    depth = DepthErrors(**found["depth"]) if found["depth"] else None
    if path.get("reversed"):
        order = "inside out: the path runs backwards, near and far are exchanged"
        if depth is not None and depth.rank_in_order is not None:
            order = "the true poses contradict the true depth: are they camera-to-world, or in reverse order?"
        said.append(("order", order))
    if depth is not None:
        said.append(("depth", ", ".join(depth.in_words())))
    said.append(("residual", f"{found['residual']['rms']:.4f} rms of full scale"))
    if found["residual"]["chi2_per_pixel"] is not None:
        said.append(("χ² per pixel", f"{found['residual']['chi2_per_pixel']:.3f}"))
    return said
