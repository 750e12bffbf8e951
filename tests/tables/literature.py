"""The methods of the literature that tables compare with ours: decoders, and a radiance field.

Here: their names, their calls, and the rows of figures that they return. Not here: the decoders
(`gs2ci.reconstruct.decode`), the field (`tests.tables`), SCISplat, which is a variant of our own
settings (`variants`).
"""

import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.evaluate.depth import depth_errors, parallax_of
from gs2ci.evaluate.metrics import psnr_per_view, ssim_per_view
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.choices import ModelName
from gs2ci.reconstruct.decode.denoisers import TotalVariation
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, choose_coupling, gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import patch_decode
from gs2ci.reconstruct.decode.pnp import plug_and_play
from gs2ci.reconstruct.first_look import look
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.learned.onnx_models import find_model, known_model
from gs2ci.reconstruct.learned.onnx_video_decoder import OnnxVideoDecoder
from gs2ci.reconstruct.learned.onnx_video_denoiser import open_denoiser
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.reconstruct.settings import Settings
from tests.tables.beside import beside_path, scores_beside
from tests.tables.cases import Case
from tests.tables.field_fit import FieldSettings, fit_field
from tests.tables.order import inside_out

_PUBLISHED: Final = GapTvSettings(weight=0.3, coupling=0.0)

Decode = Callable[[Shot, int], F32]
"""Decodes a shot, with a seed, to views, [N, H, W, C]."""

DECODERS: Final[Mapping[str, Decode]] = MappingProxyType(
    {
        "gap-tv": lambda shot, _: gap_tv(shot, _PUBLISHED),
        "gap-tv, coupled": lambda shot, seed: gap_tv(shot, choose_coupling(shot, _PUBLISHED, seed)),
        "pnp-tv": lambda shot, _: plug_and_play(shot, TotalVariation()),
        "patches-quick": lambda shot, _: patch_decode(shot, PatchSettings.quick()),
        "patches": lambda shot, _: patch_decode(shot),
    }
)
"""Decoders that need no weights. `gap-tv` is as published; `coupled` also smooths between consecutive views."""

LEARNED: Final[Mapping[str, ModelName]] = MappingProxyType(
    {
        "pnp-ffdnet": "ffdnet",
        "pnp-ffdnet-colour": "ffdnet-colour",
        "pnp-fastdvdnet": "fastdvdnet",
        "video-decoder": "video-decoder",
    }
)
"""Lines with models that a user has added by name: plug-and-play denoisers, and a network that returns views."""

FIELD: Final = "field"


def model_files(line: str) -> tuple[str, ...]:
    """Return the model file that a line depends on, if the line needs one and it has been added."""
    known = known_model(LEARNED[line]) if line in LEARNED else None
    return () if known is None else (str(known.path),)


def decode_case(case: dict[str, Any], method: str, seed: int) -> Row:
    """Decode a case; return figures in dB and seconds. A decoder estimates neither scene nor path.

    Args:
        case: Fields of a `Case`.
        method: A name in `DECODERS` or `LEARNED`.
        seed: Seed of masks and noise, and of the pixels that a decoder holds out.

    Raises:
        Gs2ciError: The case cannot be made, the method is unknown, or its model was not added.
    """
    decode = _decoder(method)
    shot = Case.of(case).shot(seed)
    began_s = time.monotonic()
    views = np.clip(decode(shot, seed), 0, 1)
    seconds = time.monotonic() - began_s
    return {**_scores(views, shot.truth.views), "seconds": seconds}


def _decoder(method: str) -> Decode:
    if method in DECODERS:
        return DECODERS[method]
    if method not in LEARNED:
        raise InputError(f"decoder {method!r}", allowed=", ".join((*DECODERS, *LEARNED)))
    path = find_model(LEARNED[method])
    if method == "video-decoder":
        network = OnnxVideoDecoder(path)
        return lambda shot, _: network(shot)
    denoise = open_denoiser(path)
    return lambda shot, _: plug_and_play(shot, denoise)


def field_case(case: dict[str, Any], iterations: int, seed: int) -> Row:
    """Fit a radiance field to a case; return figures in dB, full scales and seconds, None without a truth.

    Args:
        case: Fields of a `Case`.
        iterations: Steps of its fit.
        seed: Seed of masks, noise and the fit's random draws.

    Raises:
        Gs2ciError: The case cannot be made, or the field cannot be fitted.
    """
    made, settings = Case.of(case), Settings(seed=seed)
    shot = made.shot(seed)
    began_s = time.monotonic()
    holdout = Holdout.of(shot, 0.0, seed)  # no pixels are held out, as in the literature
    prior = load_geometry_prior(settings.poses)
    first = look(holdout, Lens.of(shot), prior, settings, Silent(), lambda _: None)
    fitted = fit_field(first.holdout.shot, first.geometry, FieldSettings(iterations=iterations), seed)
    views, depth = fitted.seen(fitted.world_to_camera)
    seconds = time.monotonic() - began_s
    truth, path = shot.truth, fitted.world_to_camera
    trajectory = None if truth.world_to_camera is None else trajectory_errors(path, truth.world_to_camera)
    parallax = None if truth.world_to_camera is None else parallax_of(truth.world_to_camera, first.geometry.intrinsics)
    errors = None if truth.depth is None else depth_errors(depth, truth.depth, parallax)
    elsewhere = scores_beside(fitted.seen(beside_path(path))[0], made.novel_views(shot))
    scores = _scores(views, truth.views)
    rank = None if errors is None else errors.rank
    return {
        **scores,
        "scene_psnr_db": scores["psnr_db"],
        **elsewhere,
        "nate": trajectory and trajectory.nate,
        "depth_rel_percent": errors and 100 * errors.median_rel,
        "depth_rank": rank,
        "failure": inside_out(None if trajectory is None else trajectory.rotation_deg, rank),
        "seconds": seconds,
    }


def _scores(views: F32, truth: F32 | None) -> Row:
    """Score views; a grey truth is compared with the mean of their colours."""
    if truth is None:
        return {"psnr_db": None, "ssim": None}
    shown = views if views.shape[3] == truth.shape[3] else views.mean(axis=3, keepdims=True)
    return {
        "psnr_db": float(np.mean(psnr_per_view(shown, truth))),
        "ssim": float(np.mean(ssim_per_view(shown, truth))),
    }
