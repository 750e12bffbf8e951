"""`gs2ci decode`: from a shot file to views, without geometry.

Here: the arguments, and the order read → decode → write → tell. Not here: any of the four (`gs2ci.api.decoding`).
"""

from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import tyro
from rich.console import Console

from gs2ci.api.decoding import check_decode, decode_all
from gs2ci.commands.answers import answered
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import DecodeMethod, RegistrationMode


def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("decoded"),
    *,
    method: DecodeMethod = "gap-tv",
    denoiser: str | None = None,
    iterations: int | None = None,
    coupling: float | None = None,
    index: int | None = None,
    all_shots: Annotated[bool, tyro.conf.arg(name="all")] = False,
    registration: RegistrationMode = "auto",
    seed: int = 42,
    overwrite: bool = False,
    json: bool = False,
) -> Path:
    """Recover the views of one exposure, or of every exposure of a file, without camera path or scene.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: The folder to write.
        method: gap-tv; patches, which takes groups of similar patches and is the best without trained weights, or
            patches-quick, a few rounds of it; plug-and-play by pnp-gap or pnp-admm; onnx:FILE, a network from
            measurement and masks to views, or video-decoder, the one added by that name; or the rough proxies that a
            geometry stage looks at: eni, amdi, or proxies for the one of the two that the masks ask for.
        denoiser: Of plug-and-play: tv (the default), nlm (non-local means), onnx:FILE, or a model added by name
            (gs2ci models add): ffdnet, ffdnet-colour, fastdvdnet.
        iterations: Steps of gap-tv (40), patches (96) or patches-quick (8), or at each of the four noise
            levels of plug-and-play (10).
        coupling: How alike gap-tv expects consecutive views to be, from 0 (not at all); chosen by held-out pixels of
            the measurement when not given.
        index: Which shot of the file; the first when not given.
        all_shots: Decode every shot of the file.
        registration: "auto" asks the measurement first where its masks lie and how they met the light, and corrects
            what it surely tells; "off" believes masks and readings as they are.
        seed: Of the draw of the held-out pixels.
        overwrite: Replace an earlier decode at the same place.
        json: Print the answer as JSON, and nothing else, on standard output.

    Returns:
        The folder.
    """
    check_decode(iterations, coupling, seed)
    if all_shots and index is not None:
        raise InputError(f"both --all and --index {index}", remedy="give one of them")
    from gs2ci.core.storage import count_shots, read_shot

    count = count_shots(shot)
    from gs2ci.evaluate.decode_folder import SCHEMA, write_decoded
    from gs2ci.evaluate.run_folder import check_destination

    check_destination(output, overwrite=overwrite, schema=SCHEMA)
    wanted = range(count) if all_shots else (index or 0,)
    with answered(as_text=not json) as answer:
        decoded = decode_all(
            (read_shot(shot, i) for i in wanted),
            method,
            denoiser,
            iterations,
            coupling,
            registration=registration,
            seed=seed,
            progress=None,
        )
        report = write_decoded(output, decoded, overwrite=overwrite)
        _print(output, report)
        answer({"folder": output, **report})
    return output


def _print(output: Path, report: dict[str, Any]) -> None:
    console = Console(highlight=False)
    count, seconds = len(report["shots"]), report["seconds"]
    console.print(
        f"{report['name']}: {count * report['views']} views from {count} exposure{'s' if count > 1 else ''} by "
        f"{report['shots'][0]['method']['name']} in {seconds:.1f} s",
        markup=False,
        soft_wrap=True,
    )
    if report["psnr_db"] is not None:
        console.print(f"PSNR {report['psnr_db']:.2f} dB, SSIM {report['ssim']:.4f} (means over views)")
    rms = fmean(shot["residual"]["rms"] for shot in report["shots"])
    console.print(f"residual {rms:.4f} rms, in units of a view's full scale")
    for note in dict.fromkeys(note for shot in report["shots"] for note in shot["notes"]):
        console.print(note, markup=False, soft_wrap=True)
    console.print(f"{output}  views/ has the pictures", markup=False, soft_wrap=True)
