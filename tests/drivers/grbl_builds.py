"""Other controllers that speak GRBL's protocol, as their twins are built."""

from tests.twins.grbl import GrblBuild

GRBLHAL = GrblBuild(
    b"GrblHAL 1.1f ['$' or '$HELP' for help]",
    "1.1f.20260817:",
    "VNM",
    avr=False,
    extra=("[FIRMWARE:grblHAL]", "[NEWOPT:ENUMS,RT+]"),
    unhomed=11,
)
FLUIDNC = GrblBuild(
    b"Grbl 3.9 [FluidNC v3.9.1 (esp32-wifi) '$' for help]",
    "3.9 FluidNC v3.9.1 (esp32-wifi) :",
    "PHS",
    avr=False,
    unlisted=frozenset({1, 13, 24, 25, 26, 27}),
    homing_mm={0: 0.0, 1: 0.0, 2: 0.0},
    unhomed=14,
)
