"""Options of a modulator on a video output: its [modulator] table, which is also the driver's options."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gs2ci.core.config import SIMULATED, ConfigTable, Count, Positive

Place = Annotated[int, Field(ge=0)]
Level = Annotated[int, Field(ge=0, le=255)]


class VideoOutOptions(ConfigTable):
    """[modulator] with kind = "video": an LCoS or DMD that is a second display. Needs the extra `video`."""

    kind: Literal["video"]
    port: str = SIMULATED
    """The video output by its name, "last" for the last one, or "simulated". `gs2ci devices` lists them."""
    dark_level: Level = 0
    """Grey level at which the optics block light."""
    bright_level: Level = 255
    """Grey level at which they pass it."""
    grey_table: tuple[Level, ...] = ()
    """Grey levels for transmissions 0 to 1 in equal steps, rising or falling, at least two, if they are not linear in
    between. Its ends are then the dark and the bright level."""
    frames_late: Annotated[int, Field(ge=0, le=16)] = 1
    """Delay of the display's electronics: the number of refreshes until a picture appears on the panel."""
    trigger_patch: tuple[Place, Place, Count, Count] | None = None
    """First row and column, rows and columns of a patch that is lit like a trigger signal, for a photodiode with a
    comparator; without it there is no trigger."""
    pitch_um: Positive = 8.0
    """Distance of neighbouring pixels."""

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.dark_level == self.bright_level:
            raise ValueError("dark_level and bright_level must be two different levels, 0 to 255")
        if len(self.grey_table) == 1:
            raise ValueError("grey_table needs two levels or more, or none")
        if self.grey_table:
            ordered = sorted(self.grey_table)
            if ordered[0] == ordered[-1] or list(self.grey_table) not in (ordered, ordered[::-1]):
                raise ValueError("grey_table must rise or fall: each level has one transmission")
            stated = {name: getattr(self, name) for name in self.model_fields_set & {"dark_level", "bright_level"}}
            ends = {"dark_level": self.grey_table[0], "bright_level": self.grey_table[-1]}
            if stated != {name: ends[name] for name in stated}:
                raise ValueError(f"grey_table ends with other levels; leave out {', '.join(sorted(stated))}")
        return self

    @property
    def greys(self) -> tuple[int, ...]:
        """Get the grey levels for transmissions 0 to 1 in equal steps: the table, otherwise dark and bright."""
        return self.grey_table or (self.dark_level, self.bright_level)
