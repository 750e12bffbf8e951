"""Which packages belong to which extra of gs2ci, and the message if one is missing.

`pip install gs2ci` installs what a bench needs to capture. Not here: the list of these packages
(pyproject.toml; `tests/test_lab_install.py` checks that the two agree).
"""

from typing import Final

from gs2ci.core.errors import InputError

EXTRAS: Final[dict[str, tuple[str, ...]]] = {
    "calibrate": ("cv2", "numba", "scipy"),
    "reconstruct": ("imageio", "jinja2", "markupsafe", "matplotlib", "onnxruntime", "pycolmap", "skimage", "torch"),
    "cluster": ("cryptography", "dask", "distributed"),
    "view": ("viser",),
    "mesh": ("trimesh",),
    "export": ("onnx",),
    "exr": ("OpenEXR",),
    "genicam": ("genicam", "harvesters"),
    "video": ("sdl2",),
    "alp": ("ALP4",),
    "gpu": ("warp",),
    "ophyd": ("bluesky", "ophyd_async"),
}
"""Extra -> the modules that it installs."""


def missing_extra(error: ModuleNotFoundError) -> InputError | None:
    """Return what to install if a module of an extra is missing; None for any other module."""
    module = (error.name or "").partition(".")[0]
    extra = next((name for name, modules in EXTRAS.items() if module in modules), None)
    if extra is None:
        return None
    remedy = f"pip install 'gs2ci[{extra}]'"
    if extra == "calibrate":
        # Which of the two is wanted, the module alone does not tell.
        remedy += " to calibrate, import and look at live pictures; for all else pip install 'gs2ci[reconstruct]'"
    return InputError(f"this needs {module}, which is not installed", remedy=remedy)
