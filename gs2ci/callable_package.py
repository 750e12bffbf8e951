"""A package that is called as the function of its name: `gs2ci.reconstruct(shot)`, `gs2ci.evaluate(run, shot)`.

The import of any module of a package binds the package's name in `gs2ci`, and would hide a function of that name there.
Here: making such a package callable. Not here: the functions.
"""

import importlib
import inspect
import sys
from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """A package whose call is that of the function which `_called` names as (module, name)."""

    _called: tuple[str, str]

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the function; nothing of it is loaded before."""
        return self._function(*arguments, **named)

    @property
    def __signature__(self) -> inspect.Signature:
        """Get the function's signature, for completion."""
        return inspect.signature(self._function)

    @property
    def __doc__(self) -> str | None:  # type: ignore[override]
        """Get the function's docstring, for `help` and for `?` in a notebook."""
        return inspect.getdoc(self._function)

    @property
    def _function(self) -> Any:
        module, name = self._called
        return getattr(importlib.import_module(module), name)


def make_callable(package: str, module: str, name: str) -> None:
    """Make a package callable.

    Args:
        package: Its name; it is being imported.
        module: Where the function is defined.
        name: The function's.
    """
    found = sys.modules[package]
    found.__class__ = CallablePackage
    found._called = (module, name)  # type: ignore[attr-defined]
