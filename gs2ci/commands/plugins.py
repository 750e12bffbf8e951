"""`gs2ci plugins`: what other packages add, and where it comes from.

Here: the table that is printed, and the names of our own that no plug-in can take. Not here: finding them
(`gs2ci.core.plugins`).
"""

from rich.console import Console
from rich.table import Table

from gs2ci.commands.answers import answered
from gs2ci.core.plugins import GROUPS, Plugin, installed


def run(*, json: bool = False) -> list[Plugin]:
    """List the plug-ins that are installed: drivers, density rules, decoders, priors, geometry, effects, scenes.

    Each is imported; one that cannot be is named with the reason, and everything else works without it.

    Args:
        json: Print the answer as JSON, and nothing else, on standard output.

    Returns:
        The plug-ins.
    """
    with answered(as_text=not json) as answer:
        found = installed(built_in_names())
        _print(found)
        answer(found)
    return found


def _print(found: list[Plugin]) -> None:
    console = Console(highlight=False)
    if not found:
        console.print("No plug-ins are installed. docs/plugins.md says how to make one.", markup=False)
        return
    table = Table(box=None, padding=(0, 3, 0, 0))
    for heading in ("plug-in", "from", "used as", "defined in"):
        table.add_column(heading, no_wrap=heading != "defined in")
    for plugin in found:
        name = plugin.name if not plugin.problem else f"{plugin.name} (left out)"
        table.add_row(name, plugin.origin, GROUPS[plugin.group], plugin.target)
    console.print(table)
    for plugin in found:
        if plugin.problem:
            console.print(
                f"{plugin.name} of {plugin.origin} is left out: {plugin.problem}", markup=False, soft_wrap=True
            )


def built_in_names() -> dict[str, tuple[str, ...]]:
    """Return the names of our own, by group of entry points."""
    from gs2ci.reconstruct.choices import DECODE_METHODS, DECODER_GROUP, RULE_NAMES
    from gs2ci_drivers.plugin import BUILT_IN

    return {
        **BUILT_IN,
        "gs2ci.density_rules": RULE_NAMES,
        DECODER_GROUP: DECODE_METHODS,
        "gs2ci.priors": ("consistent", "nlm", "none", "difix"),
        "gs2ci.geometry": ("tracks", "stage", "wide", "uniform", "auto", "vggt"),
    }
