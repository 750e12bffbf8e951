"""Only views, without geometry: `decode`. Not here: the choice of a decoder by its name (`decoders`), any decoding."""

import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gs2ci.api.display import interrupted_within, shown
from gs2ci.api.options import check_choice, check_number, check_seed, check_whole
from gs2ci.api.shots import load
from gs2ci.core.clock import command_age_s
from gs2ci.core.durations import parse_duration_s
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.choices import REGISTRATION_MODES, DecodeMethod, RegistrationMode

if TYPE_CHECKING:
    from gs2ci.evaluate.decode_folder import Decoded

# Work after the last step: figures, pictures and files, and the end of the process.
_ENDING_S: Final = 0.25
_WRITING_S_PER_PIXEL: Final = 4e-7


def decode(
    shot: Shot | str | Path,
    method: DecodeMethod = "gap-tv",
    *,
    denoiser: str | None = None,
    iterations: int | None = None,
    coupling: float | None = None,
    budget: str | None = None,
    registration: RegistrationMode = "auto",
    seed: int = 42,
    progress: Progress | None = None,
) -> "Decoded":
    """Recover the views of one exposure, without camera path or scene.

    Args:
        shot: A shot, or a file that `load` takes.
        method: gap-tv; patches, which uses groups of similar patches and is the best without trained weights, or
            patches-quick, the same with a few steps; plug-and-play by pnp-gap; onnx:FILE, a network from
            measurement and masks to views, or video-decoder, the one added by that name; or the rough proxies for the
            geometry stage: eni, amdi, or proxies, which chooses one of the two by the masks.
        denoiser: Of plug-and-play: tv (the default), onnx:FILE, or a model added by name
            (gs2ci models add): ffdnet, ffdnet-colour, fastdvdnet.
        iterations: Steps of gap-tv (40), patches (96) or patches-quick (8), or at each of the four noise
            levels of plug-and-play (10).
        coupling: Strength with which gap-tv couples consecutive views, from 0 (not at all); by default chosen by
            held-out pixels of the measurement.
        budget: Time limit for patches per exposure, everything included, such as 5s or 1min: as many steps are made
            as fit, and the result depends on the machine's speed. The time of a command's first exposure begins at
            the start of the command, and part of it is reserved for writing.
        registration: "auto" first estimates from the measurement where its masks lie, how they are blurred and in
            which unit it was read, and corrects significant errors; "off" uses masks and readings as stated.
        seed: Seed of the draw of the held-out pixels.
        progress: Receives stages and steps, as in `reconstruct`.

    Returns:
        `views` [N, H, W, C], their prediction of the measurement, seconds, method and notes.

    Raises:
        InputError: A value cannot be used, or two contradict each other.

    Example:
        >>> shot = gs2ci.load("measurement.npz", focal_px=40.0)
        >>> gs2ci.decode(shot, iterations=5, progress=gs2ci.Silent()).views.shape
        (4, 24, 32, 3)
    """
    given = [shot.check() if isinstance(shot, Shot) else load(shot)]
    return decode_all(
        given,
        method,
        denoiser,
        iterations,
        coupling,
        budget=budget,
        registration=registration,
        seed=seed,
        progress=progress,
    )[0]


def decode_all(
    shots: Iterable[Shot],
    method: DecodeMethod,
    denoiser: str | None,
    iterations: int | None,
    coupling: float | None,
    *,
    budget: str | None,
    registration: RegistrationMode,
    seed: int,
    progress: Progress | None,
) -> "list[Decoded]":
    """Decode several shots with one decoder, as `decode` does one.

    Raises:
        InputError: As `decode`.
    """
    began_s = time.monotonic() - command_age_s()
    check_decode(iterations, coupling, budget, seed)
    check_choice("--registration", registration, REGISTRATION_MODES)
    from gs2ci.api.decoders import Choice, check_budget, decoded_by, decoder_of
    from gs2ci.reconstruct.registration.register import RegistrationSettings, register

    check_budget(method, iterations, given=budget is not None)
    choice, found = Choice(method, denoiser, iterations, coupling, seed), []
    decoder = decoder_of(choice)
    with interrupted_within(), shown(progress) as display:
        settings = RegistrationSettings(mode=registration)
        for shot in shots:
            if budget is not None:
                until_s = began_s + parse_duration_s(budget) - _writing_s(shot)
                decoder = decoder_of(replace(choice, until_s=until_s))
            found.append(decoded_by(decoder, register(shot, settings, display, seed), display))
            began_s = time.monotonic()
    return found


def _writing_s(shot: Shot) -> float:
    """Return the seconds for scoring and writing an exposure's results, on a processor of 2025 or half as fast."""
    return _ENDING_S + _WRITING_S_PER_PIXEL * shot.views * shot.size[0] * shot.size[1]


def check_decode(iterations: int | None, coupling: float | None, budget: str | None, seed: int) -> None:
    """Check the given numbers before anything is read.

    Raises:
        InputError: One is out of bounds, or the budget is no duration.
    """
    check_seed(seed)
    if budget is not None:
        parse_duration_s(budget)
    check_whole("--iterations", iterations, 1, remedy="leave --iterations out for the method's own number")
    check_number("--coupling", coupling, 0, 1e6, remedy="leave --coupling out, and held-out pixels choose it")
