"""The available renderers, by name.

`cpu` is for the CPU; `warp` is for CUDA devices (extra `gpu`; never run on one so far), `warp:cuda:1` for one of
several. Another renderer needs one class and one entry in `_BACKENDS`. Not here: what a renderer does
(`gs2ci.render.interface`), its definition in float64, which tests hold all of them to (`tests/render/reference.py`),
which one a reconstruction takes (`devices`).
"""

from collections.abc import Callable
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.core.extras import missing_extra
from gs2ci.render.interface import Backend
from gs2ci.render.settings import RasterSettings


def _load_cpu(settings: RasterSettings) -> Backend:
    # Imported here, since importing Numba takes a second, which only rendering on the CPU should cost.
    from gs2ci.render.cpu.backend import CpuBackend  # noqa: PLC0415

    return CpuBackend(settings)


def _load_warp(settings: RasterSettings, device: str | None = None) -> Backend:
    try:
        from gs2ci.render.warp.backend import WarpBackend  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise missing_extra(error) or error from error

    return WarpBackend(settings, device)


_BACKENDS: Final[dict[str, Callable[[RasterSettings], Backend]]] = {
    "cpu": _load_cpu,
    "warp": _load_warp,
}


def load_backend(name: str = "cpu", settings: RasterSettings | None = None) -> Backend:
    """Return a new backend by name.

    Args:
        name: Of the backend; `warp` also with a device of Warp's after a colon.
        settings: What it may leave out; None uses the defaults.

    Raises:
        InputError: There is none of that name, the device is not there, or the settings make no sense.
    """
    kind, _, device = name.partition(":")
    if kind not in _BACKENDS or (device and kind != "warp"):
        raise InputError(f"no rendering backend {name!r}", allowed=", ".join([*sorted(_BACKENDS), "warp:cuda:1"]))
    settings = settings or RasterSettings()
    return _load_warp(settings, device) if device else _BACKENDS[kind](settings)


def needs_compiling(name: str) -> bool:
    """Tell whether a backend's first rendering on this machine has to wait until its kernels are compiled."""
    if name != "cpu":
        return False
    import gs2ci.render.cpu.blend as kernels  # noqa: PLC0415
    from gs2ci.core.kernels import is_compiled  # noqa: PLC0415

    return not is_compiled(kernels.__name__)
