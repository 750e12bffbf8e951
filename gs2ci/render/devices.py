"""Which device renders a reconstruction: a CUDA device that works, or the CPU.

A look at two files tells at once that a computer has no NVIDIA driver; only where it has one, Warp is imported and
asked. Here: the choice, what is asked of a computer (`CudaProbe`), and the words for what a card lacks. Not here: how
much memory a shot takes (`gs2ci.reconstruct.placing`), the rendering (`warp/`), the trial of a device (`trial.py`).
"""

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from gs2ci.core.errors import Gs2ciError, InputError, ResourceError
from gs2ci.core.extras import missing_extra
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.render.cards import Card, Cuda

AUTO: Final = "auto"
CPU: Final = "cpu"
_TAIL: Final = ": the CPU renders."
_NAMES: Final = re.compile(r"auto|cpu|cuda(:\d+)?")
# NVIDIA's driver makes the first; Windows gives a Linux within it the second.
_DRIVER: Final = (Path("/dev/nvidiactl"), Path("/usr/lib/wsl/lib/libcuda.so.1"))
# The CPU's renderer and the definition differ by less (docs/gpu.md); a device that differs by more does not work.
MOST_ERROR: Final = 1e-3


def _has_driver() -> bool:
    return any(path.exists() for path in _DRIVER)


def _cuda_here() -> Cuda:
    from gs2ci.render.trial import cuda_here  # noqa: PLC0415  an extra, and slow to import

    return cuda_here()


def _error_on(device: str) -> float:
    from gs2ci.render.trial import error_on  # noqa: PLC0415

    return error_on(device)


def _refusal() -> str | None:
    # Imported by the trial of a card, if there was one.
    recording = sys.modules.get("gs2ci.render.recording")
    return None if recording is None else recording.refusal()


@dataclass(frozen=True)
class CudaProbe:
    """What is asked of a computer, cheapest first; tests give answers of their own.

    Args:
        has_driver: Whether there may be an NVIDIA driver at all; imports nothing.
        cuda: Driver and cards; raises ModuleNotFoundError without the extra `gpu`.
        error_on: Renders a small scene on a device, and returns its largest error relative to the CPU's rendering;
            raises RuntimeError where the device fails.
        refusal: Why the driver refused, in this trial, to capture launches; None if it did not.
    """

    has_driver: Callable[[], bool] = _has_driver
    cuda: Callable[[], Cuda] = _cuda_here
    error_on: Callable[[str], float] = _error_on
    refusal: Callable[[], str | None] = _refusal


@dataclass(frozen=True)
class RenderingPlace:
    """Where a reconstruction renders.

    Args:
        backend: The renderer, as `gs2ci.render.backend.load_backend` takes it.
        device: For people: "cpu", or a CUDA device with its model.
        notes: What is to be said of it: which device it is, or what kept a card from being used.
    """

    backend: str = CPU
    device: str = CPU
    notes: tuple[Finding, ...] = field(default=())


def check_device(wanted: str) -> None:
    """Check the name of a device, before anything is asked of the computer.

    Raises:
        InputError: It is none.
    """
    if not isinstance(wanted, str) or not _NAMES.fullmatch(wanted):
        raise InputError(
            f"--device {wanted}",
            allowed="auto, cpu, cuda, or one of several CUDA devices such as cuda:1",
            remedy="`gs2ci devices` lists those of this computer",
        )


def place(wanted: str, needed_mib: int, probe: CudaProbe | None = None) -> RenderingPlace:
    """Choose where to render.

    Args:
        wanted: "auto" for a CUDA device that works, otherwise the CPU; "cpu"; "cuda" for the first CUDA device that
            works; "cuda:1" and the like for this one.
        needed_mib: Memory of the device that the reconstruction takes.
        probe: What is asked of the computer; None: this one.

    Raises:
        InputError: The name is none, or a CUDA device is wanted and cannot be used.
        ResourceError: It has too little memory.
    """
    check_device(wanted)
    probe = probe or CudaProbe()
    if wanted == CPU or (wanted == AUTO and not probe.has_driver()):
        return RenderingPlace()
    found = _usable(wanted, needed_mib, probe)
    if isinstance(found, Card):
        return _tried(found, wanted, probe)
    return _refused(found, wanted)


def _usable(wanted: str, needed_mib: int, probe: CudaProbe) -> Card | Finding:
    """Return the first card that may serve, or what the first of those asked about lacks."""
    try:
        cuda = probe.cuda()
    except ModuleNotFoundError as error:
        if missing_extra(error) is None:
            raise
        return finding(Code.GPU_EXTRA_MISSING)
    if cuda.driver is None:
        return finding(Code.GPU_DRIVER_SILENT)
    if cuda.driver < cuda.least_driver:
        return finding(Code.GPU_DRIVER_OLD, driver=_dotted(cuda.driver), least=_dotted(cuda.least_driver))
    cards = [card for card in cuda.cards if ":" not in wanted or card.device == wanted]
    if not cards:
        known = ", ".join(card.device for card in cuda.cards) or "none"
        return finding(Code.GPU_NOT_THERE, wanted="CUDA device" if ":" not in wanted else wanted, known=known)
    lacks = [_lack(card, cuda, needed_mib) for card in cards]
    return next((card for card, lack in zip(cards, lacks, strict=True) if lack is None), lacks[0] or cards[0])


def _lack(card: Card, cuda: Cuda, needed_mib: int) -> Finding | None:
    """Return what a card lacks for a reconstruction; None if nothing."""
    named = named_card(card)
    if card.capability < cuda.least_capability:
        return finding(
            Code.GPU_TOO_OLD, card=named, capability=_dotted(card.capability), least=_dotted(cuda.least_capability)
        )
    if card.free_mib < needed_mib:
        return finding(Code.GPU_MEMORY_SMALL, card=named, free_mib=card.free_mib, needed_mib=needed_mib)
    return None


def _tried(card: Card, wanted: str, probe: CudaProbe) -> RenderingPlace:
    """Try a card by a small rendering: what the card shows is believed only if the CPU shows the same."""
    named = named_card(card)
    try:
        error = probe.error_on(card.device)
    except RuntimeError as failure:
        reason = str(failure).strip().splitlines() or ["no reason given"]
        return _refused(finding(Code.GPU_FAILS, card=named, reason=reason[0].rstrip(".")), wanted)
    if not error <= MOST_ERROR:
        return _refused(finding(Code.GPU_DIFFERS, card=named, error=error), wanted)
    notes, refusal = [finding(Code.GPU_USED, card=named, error=error)], probe.refusal()
    if refusal is not None:
        notes.append(finding(Code.GPU_NOT_CAPTURED, card=named, reason=refusal))
    return RenderingPlace(f"warp:{card.device}", named, tuple(notes))


def _refused(lack: Finding, wanted: str) -> RenderingPlace:
    """Return the CPU with a note of what is lacking, if that was left open.

    Raises:
        InputError: A CUDA device was asked for.
        ResourceError: Likewise, and it has too little memory.
    """
    if wanted == AUTO:
        return RenderingPlace(notes=(lack,))
    kind: type[Gs2ciError] = ResourceError if lack.code is Code.GPU_MEMORY_SMALL else InputError
    raise kind(
        f"--device {wanted}: {lack.sentence.removesuffix(_TAIL)}",
        allowed="a CUDA device that works, or --device cpu",
        remedy=lack.code.remedy.rstrip("."),
    )


def named_card(card: Card) -> str:
    """Return a device's name with its model's."""
    return f"{card.device} ({card.model})"


def _dotted(version: tuple[int, int]) -> str:
    return f"{version[0]}.{version[1]}"


def compute_devices(probe: CudaProbe | None = None) -> tuple[tuple[str, str], ...]:
    """List what may render on this computer: the name for `--device`, and a description with what it lacks.

    The CPU comes first. Nothing is rendered, and Warp is imported only where there is an NVIDIA driver.
    """
    probe = probe or CudaProbe()
    found = [(CPU, "the default where no CUDA device works")]
    if not probe.has_driver():
        return tuple(found)
    try:
        cuda = probe.cuda()
    except ModuleNotFoundError as error:
        if missing_extra(error) is None:
            raise
        return (*found, ("cuda", _advice(finding(Code.GPU_EXTRA_MISSING))))
    if not cuda.cards:
        lacking = _usable("cuda", 0, CudaProbe(cuda=lambda: cuda))
        assert isinstance(lacking, Finding)
        return (*found, ("cuda", _advice(lacking)))
    for card in cuda.cards:
        lack = _lack(card, cuda, 0)
        about = (
            f"{card.model}, compute capability {_dotted(card.capability)}, "
            f"{card.free_mib} of {card.memory_mib} MiB free"
        )
        found.append((card.device, about if lack is None else f"{about}: {_advice(lack)}"))
    return tuple(found)


def _advice(lack: Finding) -> str:
    return f"{lack.sentence} {lack.code.remedy}"
