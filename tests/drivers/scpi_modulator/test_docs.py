"""The session printed in docs/scpi-modulator.md is what the reference device really says."""

import re
from pathlib import Path

from gs2ci_drivers.scpi_modulator.packets import PROTOCOL, VERSION, block_request, request
from gs2ci_sims.wires.scpi_modulator import ScpiModulatorTwin, ScpiPanel
from gs2ci_sims.world import World

PAGE = (Path(__file__).parents[3] / "docs" / "scpi-modulator.md").read_text(encoding="utf-8")
SESSION = PAGE.rsplit("```", 2)[1].strip().splitlines()


def _bytes(line: str) -> bytes:
    return re.sub(rb"\\x([0-9A-F]{2})", lambda m: bytes([int(m[1], 16)]), line.encode("ascii"))


def test_the_documented_session_is_what_the_reference_device_says() -> None:
    world = World()
    port = ScpiModulatorTwin(world, panel=ScpiPanel(height=2, width=4)).open()
    assert len(SESSION) > 30
    for line in SESSION:
        if line.startswith("> "):
            port.write(_bytes(line[2:]) + b"\n", 1.0)
            world.clock.sleep_s(0.02)
        else:
            assert port.read(200, 0.0).decode("ascii").strip() == line[2:]
    assert port.read(200, 1.0) == b""


def test_the_driver_builds_the_documented_lines() -> None:
    sent = [_bytes(line[2:]) + b"\n" for line in SESSION if line.startswith("> ")]
    assert request(1, "SYST:VERS?") == sent[0]
    assert block_request(6, 0, b"\xa0\x50") == sent[5]


def test_the_page_names_the_version_and_every_error_of_the_reference_device() -> None:
    from gs2ci_sims.wires import scpi_modulator  # noqa: PLC0415

    assert f"{PROTOCOL},{VERSION}" in PAGE
    for code, text in scpi_modulator._TEXTS.items():
        assert f"| {str(code).replace('-', '−')} | {text} |" in PAGE


def test_the_page_names_every_command_of_the_reference_device() -> None:
    commands = ScpiModulatorTwin(World())._commands
    assert [command for command in commands if not re.search(rf"`{re.escape(command)}[` ]", PAGE)] == []
