"""`gs2ci evaluate`: judge a finished run by a truth, by the sensor's noise, by views from elsewhere.

Here: the arguments, and the table that is printed. Not here: any figure (`gs2ci.evaluate.evaluation`).
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import tyro
from rich.console import Console
from rich.table import Table

from gs2ci.commands.options import check_number
from gs2ci.core.errors import InputError

if TYPE_CHECKING:
    from gs2ci.core.arrays import F32

# Beyond what any sensor has; their squares and quotients stay numbers.
READ_NOISE_RANGE: Final = (1e-9, 1e3)
ELECTRONS_RANGE: Final = (1e-3, 1e12)


def run(
    folder: Annotated[Path, tyro.conf.Positional],
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    *,
    index: int = 0,
    depth: Path | None = None,
    novel: Path | None = None,
    read_noise: float | None = None,
    electrons: float | None = None,
    lpips: str | None = None,
) -> Path:
    """Judge a finished run by what is known of its shot.

    Args:
        folder: The run folder, as `gs2ci reconstruct` wrote it.
        shot: The shot file that was reconstructed, or one of the same measurement that holds the truth as well.
        output: The JSON file to write; "evaluation.json" in the run folder if not given.
        index: Which shot of the file.
        depth: True depth along the optical axis, a .npy file of [N, H, W] in any unit, 0 where unknown.
        novel: True views from other places, an .npz file of `views` and `world_to_camera` in the true path's world.
        read_noise: Standard deviation of the sensor in the dark, in full scales of one view, for chi-squared.
        electrons: Electrons of a pixel at the full scale of one view, for the shot noise in chi-squared; without it
            none is counted.
        lpips: "lpips" for the model added by `gs2ci models add lpips`, or an ONNX file of your own.

    Returns:
        The JSON file.

    Raises:
        Gs2ciError: A file or a value cannot be used, or the shot is of another measurement than the run.
    """
    check_number("--read-noise", read_noise, *READ_NOISE_RANGE, remedy="leave --read-noise out, and χ² with it")
    check_number("--electrons", electrons, *ELECTRONS_RANGE, remedy="leave --electrons out, and shot noise with it")
    if electrons is not None and read_noise is None:
        raise InputError("--electrons without --read-noise", remedy="give both, for χ² per pixel")
    from gs2ci.core.storage import read_shot

    measured = read_shot(shot, index)
    from gs2ci.evaluate.evaluation import ReferenceData, evaluate, read_run, write_evaluation
    from gs2ci.evaluate.noise import SensorNoise
    from gs2ci.evaluate.novel_views import read_novel_views
    from gs2ci.evaluate.pages.run_evidence import check_same_shot
    from gs2ci.reconstruct.fit.perceptual import load_distance

    noise = None if read_noise is None else SensorNoise(read_noise, math.inf if electrons is None else electrons)
    check_same_shot(folder, measured)
    evidence = ReferenceData(
        measured,
        None if depth is None else _read_depth(depth),
        None if novel is None else read_novel_views(novel),
        noise,
        None if lpips is None else load_distance(lpips if lpips == "lpips" else f"lpips:{lpips}"),
    )
    found = evaluate(read_run(folder), evidence)
    written = write_evaluation(output or folder / "evaluation.json", found)
    table = Table(show_header=False, box=None)
    for name, value in rows(found):
        table.add_row(name, value)
    console = Console()
    console.print(table)
    for note in found["notes"]:
        console.print(note["sentence"], markup=False, soft_wrap=True)
    console.print(str(written), soft_wrap=True)
    return written


def rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Lay out the figures that are known, a name and a value each."""
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
    if path.get("reversed"):
        said.append(("order", "inside out: the path runs backwards, near and far are exchanged"))
    if found["depth"]:
        from gs2ci.evaluate.depth import DepthErrors

        said.append(("depth", ", ".join(DepthErrors(**found["depth"]).in_words())))
    said.append(("residual", f"{found['residual']['rms']:.4f} rms of full scale"))
    if found["residual"]["chi2_per_pixel"] is not None:
        said.append(("χ² per pixel", f"{found['residual']['chi2_per_pixel']:.3f}"))
    return said


def _read_depth(path: Path) -> "F32":
    from gs2ci.core.foreign.assemble import load_single

    depth = load_single(path).values
    if depth.ndim not in (2, 3):
        raise InputError(f"{path} holds no depth but shape {list(depth.shape)}", allowed="a .npy file of [N, H, W]")
    return depth.astype("f4")
