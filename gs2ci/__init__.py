"""gs2ci: hardware-in-the-loop snapshot compressive imaging.

    import gs2ci

    shot = gs2ci.load("measurement.npz")
    run = gs2ci.reconstruct(shot, preset="draft")
    run.show()

Here: which names are public and where each is defined; each is loaded when it is first asked for, so that `import
gs2ci` takes no time and one part never loads another. What these names are for type checkers stands in `__init__.pyi`.
Everything else is imported from the module that defines it. Not here: anything else.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

# Where public names are defined.
_DEFINED = {
    "gs2ci.api.shots": ("import_file", "load", "recover", "save"),
    "gs2ci.api.reconstruction": ("reconstruct",),
    "gs2ci.api.many": ("reconstruct_many",),
    "gs2ci.api.exports": ("export", "mesh"),
    "gs2ci.api.runs": ("Run", "open_run"),
    "gs2ci.api.decoding": ("decode",),
    "gs2ci.api.scoring": ("evaluate", "measure"),
    "gs2ci.api.costs": ("tradeoff",),
    "gs2ci.api.rigs": ("OpenRig", "find_devices", "open_rig"),
    "gs2ci.api.ophyd": ("ophyd_bench",),
    "gs2ci.api.designing": ("design",),
    "gs2ci.api.plans": ("explain", "plan"),
    "gs2ci.api.sweeps": ("sweep",),
    "gs2ci.api.bundles": ("update_bundle",),
    "gs2ci.api.plugins": ("list_plugins",),
    "gs2ci.api.preparing": ("compile_kernels",),
    "gs2ci.api.demonstration": ("demo_rig",),
    "gs2ci.api.models": ("add_model", "export_model", "list_models"),
    "gs2ci.core.records": ("Shot", "Truth"),
    "gs2ci.core.progress": ("Progress", "Silent"),
    "gs2ci.core.errors": (
        *("DeviceError", "GeometryError", "Gs2ciError", "InputError", "NumericsError", "ResourceError"),
        "StorageError",
    ),
    "gs2ci.render.gaussians": ("Gaussians",),
}
_MODULE_OF = {name: module for module, names in _DEFINED.items() for name in names}
# Functions that a package of the same name already is: such a package is called (`gs2ci.callable_package`).
_PACKAGES = ("evaluate", "reconstruct")

__all__ = sorted((*_MODULE_OF, "__version__"))  # noqa: PLE0605  a list all the same


def __getattr__(name: str) -> Any:
    """Load a public name.

    Raises:
        AttributeError: There is none of that name.
    """
    if name in _PACKAGES:
        return importlib.import_module(f"gs2ci.{name}")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'gs2ci' has no attribute {name!r}")
    value = getattr(importlib.import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, whether or not they were loaded yet."""
    return sorted({*globals(), *__all__})
