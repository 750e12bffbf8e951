"""The decoder chosen by the options of `gs2ci decode`.

Here: valid combinations of options, and the decoder that they choose. Not here: any decoding
(`gs2ci.reconstruct.decode`, `proxies`).
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, finding
from gs2ci.core.plugins import PluginError, allowed, called, load
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.evaluate.decode_folder import Decoded
from gs2ci.reconstruct.choices import DECODE_METHODS, DECODER_GROUP, DENOISER_NAMES, DecodeMethod
from gs2ci.reconstruct.decode.denoisers import Denoiser, TotalVariation
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, choose_coupling, gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import decode_until, patch_decode
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, plug_and_play
from gs2ci.reconstruct.learned.onnx_models import find_model
from gs2ci.reconstruct.learned.onnx_video_decoder import OnnxVideoDecoder
from gs2ci.reconstruct.learned.onnx_video_denoiser import open_denoiser
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.doubts import doubts_about
from gs2ci.reconstruct.measurement.faulty import close_faulty_pixels
from gs2ci.reconstruct.paper.proxies.routing import build_proxies
from gs2ci.reconstruct.registration.register import Registered

# Views, a record of the decode as plain values, and sentences about it.
_Outcome = tuple[F32, Mapping[str, Any], tuple[str, ...]]
Decoder = Callable[[Shot, Progress], _Outcome]

# The published schedule of GAP-TV. The pipeline, which decodes to track, smooths less (GapTvSettings).
_GAP_TV_WEIGHT = 0.3


@dataclass(frozen=True)
class Choice:
    """Options of the command line for the decoder.

    Args:
        method: Its name.
        denoiser: Of plug-and-play.
        iterations: Number of steps; None for the method's default.
        coupling: Of GAP-TV.
        seed: Seed of the draw of the held-out pixels.
        until_s: The time, by `time.monotonic`, before which the patch decode has to end; None for no limit.
    """

    method: DecodeMethod
    denoiser: str | None
    iterations: int | None
    coupling: float | None
    seed: int
    until_s: float | None = None


def decoder_of(choice: Choice) -> Decoder:
    """Choose the decoder; a model file is loaded now, before any work.

    Raises:
        InputError: Two options contradict each other, or a denoiser is unknown or cannot be loaded.
    """
    plug = choice.method == "pnp-gap"
    if choice.denoiser is not None and not plug:
        raise InputError(f"--denoiser with --method {choice.method}", allowed="with pnp-gap")
    if choice.coupling is not None and choice.method != "gap-tv":
        raise InputError(f"--coupling with --method {choice.method}", allowed="with gap-tv")
    check_budget(choice.method, choice.iterations, given=choice.until_s is not None)
    if plug:
        return _plug_and_play_decoder(choice)
    if choice.method == "gap-tv":
        return _gap_tv_decoder(choice)
    if choice.method in ("patches", "patches-quick"):
        return _patch_decoder(choice)
    if choice.iterations is not None:
        raise InputError(f"--iterations with --method {choice.method}", allowed="with methods that iterate")
    if choice.method == "video-decoder" or choice.method.startswith("onnx:"):
        return _network_decoder(choice.method)
    if choice.method in DECODE_METHODS:
        return _proxy_decoder(choice.method)
    return _plugged_decoder(choice.method)


def check_budget(method: DecodeMethod, iterations: int | None, *, given: bool) -> None:
    """Check that a time budget is given only for a decoder that supports it, and without a number of steps.

    Raises:
        InputError: Another method, or a number of steps, is given as well.
    """
    if given and method != "patches":
        raise InputError(f"--budget with --method {method}", allowed="with patches, which makes as many steps as fit")
    if given and iterations is not None:
        raise InputError("both --budget and --iterations", remedy="give one of them")


def _plugged_decoder(name: str) -> Decoder:
    found = load(DECODER_GROUP, name)
    if found is None:
        raise InputError(f"no method {name!r}", allowed=f"{allowed(DECODER_GROUP, DECODE_METHODS)}, onnx:FILE")

    def decode(shot: Shot, progress: Progress) -> _Outcome:
        progress.stage(name)
        views = called(name, lambda: np.asarray(found(shot, progress), np.float32))
        wanted = (*shot.masks.shape, shot.measurement.shape[2] if shot.cfa is None else 3)
        if views.shape != wanted or not np.isfinite(views).all():
            raise PluginError(
                f"the decoder {name!r} returned {list(views.shape)}, not finite or not of the required shape",
                allowed=f"finite views of shape {list(wanted)}",
            )
        return views, {"name": name}, ()

    return decode


def _network_decoder(name: str) -> Decoder:
    path = find_model("video-decoder") if name == "video-decoder" else Path(name.removeprefix("onnx:"))
    network = OnnxVideoDecoder(path)

    def decode(shot: Shot, progress: Progress) -> _Outcome:
        progress.stage("decode")
        return np.clip(network(shot), 0, 1), {"name": "network", "model": path.name}, ()

    return decode


def _gap_tv_decoder(choice: Choice) -> Decoder:
    settings = GapTvSettings(weight=_GAP_TV_WEIGHT, clamped=True)
    if choice.iterations is not None:
        settings = replace(settings, iterations=choice.iterations)
    fixed = replace(settings, coupling=choice.coupling).check() if choice.coupling is not None else None
    settings.check()

    def decode(shot: Shot, progress: Progress) -> _Outcome:
        used = fixed or choose_coupling(shot, settings, choice.seed)
        return gap_tv(shot, used, progress), {"name": "gap-tv", **asdict(used)}, ()

    return decode


def _patch_decoder(choice: Choice) -> Decoder:
    if choice.until_s is not None:
        return _hurried_decoder(choice.until_s, choice.seed)
    settings = PatchSettings.quick() if choice.method == "patches-quick" else PatchSettings()
    if choice.iterations is not None:
        settings = replace(settings, iterations=choice.iterations)
    settings.check()

    def decode(shot: Shot, progress: Progress) -> _Outcome:
        return patch_decode(shot, settings, progress, choice.seed), {"name": choice.method, **asdict(settings)}, ()

    return decode


def _hurried_decoder(until_s: float, seed: int) -> Decoder:
    def decode(shot: Shot, progress: Progress) -> _Outcome:
        found = decode_until(shot, until_s, progress=progress, seed=seed)
        note = finding(Code.DECODE_HURRIED, steps=found.steps) if found.steps else finding(Code.DECODE_OUT_OF_TIME)
        said = {"name": "patches", **asdict(found.settings), "iterations": found.steps}
        return found.views, said, (note.advice,)

    return decode


def _plug_and_play_decoder(choice: Choice) -> Decoder:
    settings = PlugAndPlaySettings()
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


def _proxy_decoder(method: DecodeMethod) -> Decoder:
    wanted: Literal["auto", "eni", "amdi"] = "eni" if method == "eni" else "amdi" if method == "amdi" else "auto"

    def decode(shot: Shot, progress: Progress) -> _Outcome:
        progress.stage("proxies")
        proxies = build_proxies(shot, wanted)
        said = {"name": proxies.method, "multiplicity": proxies.multiplicity}
        return proxies.views, said, (proxies.note.advice,) if proxies.note else ()

    return decode


def _denoiser(name: str) -> Denoiser:
    if name == "tv":
        return TotalVariation()
    if name.startswith("onnx:"):
        return open_denoiser(Path(name.removeprefix("onnx:")))
    known = next((model for model in DENOISER_NAMES if model == name), None)
    if known is not None:
        return open_denoiser(find_model(known))
    raise InputError(f"denoiser {name!r}", allowed=f"tv, onnx:FILE, {', '.join(DENOISER_NAMES)}")


def decoded_by(decode: Decoder, registered: Registered, progress: Progress) -> Decoded:
    """Decode a shot without its faulty pixels; also return the measurement that its views predict, and the seconds."""
    began_s = time.monotonic()
    shot, faulty = close_faulty_pixels(registered.shot)
    views, method, notes = decode(shot, progress)
    seconds = time.monotonic() - began_s
    predicted = Coding.of(shot).forward(torch.from_numpy(views)).numpy()
    said = (note.advice for note in (*registered.notes, *doubts_about(registered.shot), *faulty))
    return Decoded(shot, views, predicted, seconds, method, (*said, *notes))
