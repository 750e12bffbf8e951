"""`gs2ci doctor`: possible faults of a bench, each with its remedy.

Here: the arguments and the printing. Not here: the checks (`gs2ci.rig.doctor`).
"""

from pathlib import Path

from rich.console import Console

from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.errors import Gs2ciError

MARKS = {"ok": "[green]ok  [/]", "note": "[yellow]note[/]", "bad": "[bold red]BAD [/]", "know": "[dim]know[/]"}


def run(*, rig: Path, trigger_loop: bool = True, json: AsJson = False) -> None:
    """Check a bench: permissions, firmware, faults, clocks and the trigger line. The stage does not move.

    Args:
        rig: The rig file.
        trigger_loop: Show eight masks and count the frames that they trigger; replaces the patterns loaded on the
            modulator.
    """
    from gs2ci.api.rigs import open_rig

    console = Console(highlight=False)
    with answered(json) as answer, open_rig(rig) as opened:
        found = []
        for finding in opened.doctor(trigger_loop=trigger_loop):
            found.append(finding)
            console.print(MARKS[finding.verdict], end=" ")
            say(f"{finding.what}: {finding.detail}")
            for line in finding.remedy.splitlines():
                say(f"       {line}")
        bad = [finding.what for finding in found if finding.verdict == "bad"]
        if not bad:
            say("nothing was found that would keep this bench from working")
        answer(found)
    if bad:
        raise Gs2ciError(
            f"{len(bad)} finding{'s' if len(bad) > 1 else ''} would keep this bench from working: {', '.join(bad)}",
            remedy="see the lines marked BAD above",
        )
