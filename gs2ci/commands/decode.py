"""`gs2ci decode`: from a shot file to views, without geometry.

Here: the arguments, and the order read → decode → write → tell. Not here: any of the four. Only `gs2ci.cli` imports
this file.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
import tyro
from rich.console import Console

from gs2ci.commands.display import open_display
from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.core.storage import count_shots, read_shot
from gs2ci.evaluate.decode_folder import SCHEMA, Decoded, write_decoded
from gs2ci.evaluate.run_folder import check_destination
from gs2ci.reconstruct.coding import Coding
from gs2ci.reconstruct.decode.coupling import choose_coupling
from gs2ci.reconstruct.decode.denoisers import Denoiser, NonLocalMeans, TotalVariation
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.onnx_denoiser import OnnxDenoiser
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, plug_and_play
from gs2ci.reconstruct.proxies.routing import build_proxies

Method = Literal["gap-tv", "pnp-gap", "pnp-admm", "proxies", "eni", "amdi"]
# Views, what was done as plain values, and sentences about it.
_Outcome = tuple[F32, Mapping[str, Any], tuple[str, ...]]
_Decoder = Callable[[Shot, Progress], _Outcome]

# The published schedule of GAP-TV. The pipeline, which decodes to track, smooths less (GapTvSettings).
_GAP_TV_WEIGHT = 0.3


@dataclass(frozen=True)
class _Choice:
    """What the command line says about the decoder."""

    method: Method
    denoiser: str | None
    iterations: int | None
    coupling: float | None
    seed: int


def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("decoded"),
    *,
    method: Method = "gap-tv",
    denoiser: str | None = None,
    iterations: int | None = None,
    coupling: float | None = None,
    index: int | None = None,
    all_shots: Annotated[bool, tyro.conf.arg(name="all")] = False,
    seed: int = 42,
    overwrite: bool = False,
) -> Path:
    """Recover the views of one exposure, or of every exposure of a file, without camera path or scene.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: The folder to write.
        method: gap-tv, or plug-and-play by pnp-gap or pnp-admm; or the rough proxies that a geometry stage looks at:
            eni, amdi, or proxies for the one of the two that the masks ask for.
        denoiser: Of plug-and-play: tv (the default), nlm (non-local means), or onnx:FILE.
        iterations: Steps of gap-tv (40), or at each of the four noise levels of plug-and-play (10).
        coupling: How alike gap-tv expects consecutive views to be, from 0 (not at all); chosen by held-out pixels of
            the measurement when not given.
        index: Which shot of the file; the first when not given.
        all_shots: Decode every shot of the file.
        seed: Of the draw of the held-out pixels.
        overwrite: Replace an earlier decode at the same place.

    Returns:
        The folder.
    """
    if seed < 0:
        raise InputError(f"--seed {seed}", allowed="0 or more")
    check_destination(output, overwrite=overwrite, schema=SCHEMA)
    decode = _decoder(_Choice(method, denoiser, iterations, coupling, seed))
    if all_shots and index is not None:
        raise InputError(f"both --all and --index {index}", remedy="give one of them")
    wanted = range(count_shots(shot)) if all_shots else (index or 0,)
    with open_display() as display:
        decoded = [_decoded(read_shot(shot, i), decode, display) for i in wanted]
    report = write_decoded(output, decoded, overwrite=overwrite)
    _print(output, report)
    return output


def _decoded(shot: Shot, decode: _Decoder, progress: Progress) -> Decoded:
    began_s = time.monotonic()
    views, method, notes = decode(shot, progress)
    seconds = time.monotonic() - began_s
    predicted = Coding.of(shot).forward(torch.from_numpy(views)).numpy()
    return Decoded(shot, views, predicted, seconds, method, notes)


def _decoder(choice: _Choice) -> _Decoder:
    """Choose the decoder; a model file is loaded now, before any work."""
    plug = choice.method in ("pnp-gap", "pnp-admm")
    if choice.denoiser is not None and not plug:
        raise InputError(f"--denoiser with --method {choice.method}", allowed="with pnp-gap and pnp-admm")
    if choice.coupling is not None and choice.method != "gap-tv":
        raise InputError(f"--coupling with --method {choice.method}", allowed="with gap-tv")
    if plug:
        return _plug_and_play_decoder(choice)
    if choice.method == "gap-tv":
        return _gap_tv_decoder(choice)
    if choice.iterations is not None:
        raise InputError(f"--iterations with --method {choice.method}", allowed="with methods that iterate")
    return _proxy_decoder(choice.method)


def _gap_tv_decoder(choice: _Choice) -> _Decoder:
    settings = GapTvSettings(weight=_GAP_TV_WEIGHT)
    if choice.iterations is not None:
        settings = replace(settings, iterations=choice.iterations)
    fixed = replace(settings, coupling=choice.coupling).check() if choice.coupling is not None else None
    settings.check()

    def decode(shot: Shot, progress: Progress) -> _Outcome:
        used = fixed or choose_coupling(shot, settings, choice.seed)
        return gap_tv(shot, used, progress), {"name": "gap-tv", **asdict(used)}, ()

    return decode


def _plug_and_play_decoder(choice: _Choice) -> _Decoder:
    settings = PlugAndPlaySettings(scheme="gap" if choice.method == "pnp-gap" else "admm")
    if choice.iterations is not None:
        settings = replace(settings, iterations=choice.iterations)
    settings.check()
    name = choice.denoiser or "tv"
    denoise = _denoiser(name)
    said = f"onnx:{Path(name[5:]).name}" if name.startswith("onnx:") else name

    def decode(shot: Shot, progress: Progress) -> _Outcome:
        views = np.clip(plug_and_play(shot, denoise, settings, progress), 0, 1)
        return views, {"name": choice.method, "denoiser": said, **asdict(settings)}, ()

    return decode


def _proxy_decoder(method: Method) -> _Decoder:
    wanted: Literal["auto", "eni", "amdi"] = "eni" if method == "eni" else "amdi" if method == "amdi" else "auto"

    def decode(shot: Shot, progress: Progress) -> _Outcome:
        progress.stage("proxies")
        proxies = build_proxies(shot, wanted)
        said = {"name": proxies.method, "multiplicity": proxies.multiplicity}
        return proxies.views, said, (proxies.note,) if proxies.note else ()

    return decode


def _denoiser(name: str) -> Denoiser:
    if name == "tv":
        return TotalVariation()
    if name == "nlm":
        return NonLocalMeans()
    if name.startswith("onnx:"):
        return OnnxDenoiser(Path(name.removeprefix("onnx:")))
    raise InputError(f"denoiser {name!r}", allowed="tv, nlm, onnx:FILE")


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
    rms = float(np.mean([shot["residual"]["rms"] for shot in report["shots"]]))
    console.print(f"residual {rms:.4f} rms, in units of a view's full scale")
    for note in dict.fromkeys(note for shot in report["shots"] for note in shot["notes"]):
        console.print(note, markup=False, soft_wrap=True)
    console.print(f"{output}  views/ has the pictures", markup=False, soft_wrap=True)
