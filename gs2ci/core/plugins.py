"""Plug-ins of other packages, by entry points: their groups, those that are installed, loading one.

A package names its parts in its pyproject.toml:

    [project.entry-points."gs2ci.density_rules"]
    mine = "my_package.density:RULE"

Nothing is imported before it is requested by its name. If one cannot be loaded, its request and `gs2ci plugins` report
it with its package; nothing else is affected. Not here: the interface of each group (docs/plugins.md).
"""

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final, TypeVar

from gs2ci.core.errors import Gs2ciError, InputError

_Answer = TypeVar("_Answer")

GROUPS: Final[dict[str, str]] = {
    "gs2ci.modulators": "[modulator] kind of a rig file",
    "gs2ci.sensors": "[sensor] kind of a rig file",
    "gs2ci.stages": "[stage] kind of a rig file",
    "gs2ci.density_rules": "gs2ci reconstruct --density",
    "gs2ci.decoders": "gs2ci decode --method",
    "gs2ci.priors": "gs2ci reconstruct --prior",
    "gs2ci.geometry": "gs2ci reconstruct --geometry",
    "gs2ci.effects": "[effects.NAME] of a rig file",
    "gs2ci.scenes": "scene of a simulation",
}
"""Group of entry points -> where a user names one of its plug-ins."""


class PluginError(InputError):
    """A plug-in was requested and cannot be used."""


@dataclass(frozen=True)
class Plugin:
    """One entry point.

    Args:
        group: One of `GROUPS`.
        name: By which users ask for it.
        target: "module:attribute".
        package: The distribution that provides it, "" if unknown.
        version: Of that distribution.
        problem: Why it cannot be used; "" if it can.
    """

    group: str
    name: str
    target: str
    package: str
    version: str
    problem: str = ""

    @property
    def origin(self) -> str:
        """Get its origin, in words."""
        return f"{self.package} {self.version}".strip() or "a package without a name"


def names(group: str) -> tuple[str, ...]:
    """Return the names of a group's plug-ins, sorted; nothing is imported."""
    return tuple(sorted({entry.name for entry in entry_points(group=group)}))


def allowed(group: str, built_in: tuple[str, ...]) -> str:
    """List the available names, built-in ones first."""
    return ", ".join((*built_in, *(name for name in names(group) if name not in built_in)))


def load(group: str, name: str) -> Any | None:
    """Load a plug-in; None if no package has one of that name.

    Raises:
        PluginError: It cannot be imported, or two packages provide one of that name.
    """
    found = _entries(group, name)
    if not found:
        return None
    plugin = _described(found)
    if plugin.problem:
        raise PluginError(
            f"the plug-in {name!r} of {plugin.origin} cannot be used: {plugin.problem}",
            remedy=f"mend or remove that package; {GROUPS[group]} takes other names",
        )
    return found[0].load()


def called(name: str, work: Callable[..., _Answer], *given: Any) -> _Answer:
    """Call a plug-in, or what one returned.

    Raises:
        PluginError: It failed in a way of its own.
        Gs2ciError: It said in ours what is wrong.
        MemoryError: There is not enough of it.
    """
    try:
        return work(*given)
    except (Gs2ciError, MemoryError):
        raise
    except Exception as error:  # foreign code may raise anything
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"line {where.lineno} of {Path(where.filename).name}"
        raise PluginError(
            f"the plug-in {name!r} failed: {type(error).__name__}: {error} ({place})",
            remedy="ask its authors, or leave it out",
        ) from error


def brought(group: str, name: str, *given: Any) -> Any | None:
    """Call a plug-in that is a function; None if no package has one of that name.

    Raises:
        PluginError: It cannot be imported, or fails; or, at a call of what it returned, that fails.
    """
    found = load(group, name)
    return None if found is None else _Brought(name, called(name, found, *given))


@dataclass(frozen=True)
class _Brought:
    """What a plug-in returned; its calls fail in its name."""

    of: str
    it: Any

    def __call__(self, *given: Any) -> Any:
        return called(self.of, self.it, *given)

    def __getattr__(self, key: str) -> Any:
        return getattr(self.it, key)


def installed(built_in: dict[str, tuple[str, ...]] | None = None) -> list[Plugin]:
    """Return every installed plug-in, by group and name; each is imported, and has a `problem` if that fails.

    Args:
        built_in: Built-in names by group, which a plug-in cannot take.
    """
    plugins = []
    for group in GROUPS:
        own = (built_in or {}).get(group, ())
        plugins += [_described(_entries(group, name), taken=name in own) for name in names(group)]
    return plugins


def _entries(group: str, name: str) -> list[EntryPoint]:
    # A package may be on the path twice, as installed and as its sources: that is one plug-in.
    found = {(entry.value, _package(entry)): entry for entry in entry_points(group=group, name=name)}
    return list(found.values())


def _described(found: list[EntryPoint], *, taken: bool = False) -> Plugin:
    first = found[0]
    problem = ""
    if taken:
        problem = "gs2ci has one of that name itself"
    elif len(found) > 1:
        problem = f"{' and '.join(_package(entry) for entry in found)} both bring one of that name"
    else:
        try:
            first.load()
        except Exception as error:  # a foreign module may raise anything when it is imported
            problem = f"{type(error).__name__}: {error}"
    version = first.dist.version if first.dist is not None else ""
    return Plugin(first.group, first.name, first.value, _package(first), version, problem)


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else ""
