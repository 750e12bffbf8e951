"""Which packages come with which extra of gs2ci, and what to say where one is missing.

`pip install gs2ci` brings what a bench needs: capture, calibration, import. Not here: which packages those are
(pyproject.toml; `tests/test_lab_install.py` holds the two together).
"""

from typing import Final

from gs2ci.core.errors import InputError

EXTRAS: Final[dict[str, tuple[str, ...]]] = {
    "reconstruct": ("imageio", "jinja2", "markupsafe", "matplotlib", "onnxruntime", "pycolmap", "skimage", "torch"),
    "cluster": ("dask", "distributed"),
    "view": ("viser",),
    "mesh": ("trimesh",),
    "export": ("onnx",),
    "exr": ("OpenEXR",),
    "genicam": ("genicam", "harvesters"),
    "video": ("sdl2",),
    "ophyd": ("bluesky", "ophyd_async"),
}
"""Extra -> the modules that it brings."""


def missing_extra(error: ModuleNotFoundError) -> InputError | None:
    """Say what to install where a module of an extra is missing; None where it is another module."""
    module = (error.name or "").partition(".")[0]
    extra = next((name for name, modules in EXTRAS.items() if module in modules), None)
    if extra is None:
        return None
    return InputError(f"this needs {module}, which is not installed", remedy=f"pip install 'gs2ci[{extra}]'")
