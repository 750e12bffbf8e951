"""`gs2ci decode`: from a shot file to views, without geometry.

Here: the arguments, and the order read → decode → write → print. Not here: any of the four (`gs2ci.api.decoding`).
"""

from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import tyro

from gs2ci.api.decoding import check_decode, decode, decode_all
from gs2ci.api.derived import with_options_of
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.errors import InputError


@with_options_of(decode, without=("progress",))
def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("decoded"),
    *,
    index: int | None = None,
    all_shots: Annotated[bool, tyro.conf.arg(name="all")] = False,
    overwrite: bool = False,
    json: AsJson = False,
    **options: Any,
) -> Path:
    """Recover the views of one exposure, or of every exposure of a file, without camera path or scene.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: The folder to write.
        index: Which shot of the file; by default the first.
        all_shots: Decode every shot of the file.
        overwrite: Replace an earlier decode at the same place.

    Returns:
        The folder.
    """
    check_decode(options["iterations"], options["coupling"], options["budget"], options["seed"])
    if all_shots and index is not None:
        raise InputError(f"both --all and --index {index}", remedy="give one of them")
    from gs2ci.core.storage import count_shots, read_shot

    count = count_shots(shot)
    from gs2ci.evaluate.decode_folder import SCHEMA, write_decoded
    from gs2ci.evaluate.whole_folder import check_destination

    check_destination(output, overwrite=overwrite, schema=SCHEMA)
    wanted = range(count) if all_shots else (index or 0,)
    with answered(json) as answer:
        decoded = decode_all((read_shot(shot, i) for i in wanted), progress=None, **options)
        report = write_decoded(output, decoded, overwrite=overwrite)
        _print(output, report)
        answer({"folder": output, **report})
    return output


def _print(output: Path, report: dict[str, Any]) -> None:
    count, seconds = len(report["shots"]), report["seconds"]
    say(
        f"{report['name']}: {count * report['views']} views from {count} exposure{'s' if count > 1 else ''} by "
        f"{report['shots'][0]['method']['name']} in {seconds:.1f} s"
    )
    if report["psnr_db"] is not None:
        say(f"PSNR {report['psnr_db']:.2f} dB, SSIM {report['ssim']:.4f} (means over views)")
    rms = fmean(shot["residual"]["rms"] for shot in report["shots"])
    say(f"residual {rms:.4f} rms, in units of a view's full scale")
    for note in dict.fromkeys(note for shot in report["shots"] for note in shot["notes"]):
        say(note)
    say(f"{output}  views/ has the pictures")
