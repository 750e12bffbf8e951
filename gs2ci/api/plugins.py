"""Plug-ins of other packages: `list_plugins`.

Here: the built-in names, which no plug-in can take. Not here: finding plug-ins (`gs2ci.core.plugins`).
"""

from gs2ci.core.plugins import Plugin, installed


def list_plugins() -> list[Plugin]:
    """List the plug-ins that are installed: drivers, density rules, decoders, priors, geometry, effects, scenes.

    Each is imported; `problem` says why one could not be, and everything else works without it.

    Returns:
        `name`, `group` and `target` of each, and the package that it comes from.

    Example:
        >>> [plugin.name for plugin in gs2ci.list_plugins() if plugin.problem]
        []
    """
    return installed(built_in_names())


def built_in_names() -> dict[str, tuple[str, ...]]:
    """Return the built-in names, by group of entry points."""
    from gs2ci.reconstruct.choices import DECODE_METHODS, DECODER_GROUP, RULE_NAMES
    from gs2ci_drivers.plugin import BUILT_IN

    return {
        **{group: tuple(kinds) for group, kinds in BUILT_IN.items()},
        "gs2ci.density_rules": RULE_NAMES,
        DECODER_GROUP: DECODE_METHODS,
        "gs2ci.priors": ("none", "difix"),
        "gs2ci.geometry": ("tracks", "stage", "wide", "displacements", "rest", "auto", "vggt"),
    }
