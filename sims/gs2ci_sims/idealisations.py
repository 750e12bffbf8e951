"""What the twins leave out: every idealisation of a simulated bench, real devices' behaviour, and the switch for it.

Here: the list, which `idealisations.toml` states, and the selection for a bench's devices. Not here: the effect of a
switch (each twin in `gs2ci_sims.wires`, each effect), the rig file (`gs2ci.rig.config`).
"""

import tomllib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final


@dataclass(frozen=True)
class Idealisation:
    """One property in which a twin is better than a device.

    Args:
        device: The kind of device, in words.
        twin: The twin's behaviour by default.
        real: Real devices' behaviour.
        source: The source for that.
        key: The switch below [world] of a rig file: a key, or "effects.NAME"; "" if there is none.
        ideal: The key's default; None for an effect that is off.
        typical: The value set by `devices = "typical"`; None if no figure suits most devices.
        kinds: Kinds of modulator, sensor or stage that it applies to; empty: all.
    """

    device: str
    twin: str
    real: str
    source: str
    key: str = ""
    ideal: Any = None
    typical: Any = None
    kinds: Sequence[str] = ()


_TABLE: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
IDEALISATIONS: Final = tuple(Idealisation(**one) for one in _TABLE["idealisation"])


def typical(kinds: Collection[str]) -> Iterator[Idealisation]:
    """List the idealisations of these kinds of devices for which a figure suits most real devices."""
    for one in IDEALISATIONS:
        if one.typical is not None and (not one.kinds or set(one.kinds) & set(kinds)):
            yield one
