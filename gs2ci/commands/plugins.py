"""`gs2ci plugins`: plug-ins of other packages, with their origin.

Here: the table that is printed. Not here: finding them (`gs2ci.api.plugins`).
"""

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gs2ci.api.plugins import list_plugins
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.plugins import GROUPS, Plugin


def run(*, json: AsJson = False) -> list[Plugin]:
    """List the plug-ins that are installed: drivers, density rules, decoders, priors, geometry, effects, scenes.

    Each is imported; if one cannot be, the reason is shown, and everything else works without it.

    Returns:
        The plug-ins.
    """
    with answered(json) as answer:
        found = list_plugins()
        _print(found)
        answer(found)
    return found


def _print(found: list[Plugin]) -> None:
    if not found:
        say("No plug-ins are installed. docs/plugins.md says how to make one.")
        return
    table = Table(box=None, padding=(0, 3, 0, 0))
    for heading in ("plug-in", "from", "used as", "defined in"):
        table.add_column(heading, no_wrap=heading != "defined in", overflow="fold")
    for plugin in found:
        name = plugin.name if not plugin.problem else f"{plugin.name} (left out)"
        # As they are written: brackets are no markup.
        table.add_row(*map(Text, (name, plugin.origin, GROUPS[plugin.group], plugin.target)))
    Console(highlight=False).print(table)
    for plugin in found:
        if plugin.problem:
            say(f"{plugin.name} of {plugin.origin} is left out: {plugin.problem}")
