"""Rig files that come with the simulator, calm ones first. Here: where they are. Not here: reading (`rig_file`)."""

from pathlib import Path


def library() -> list[Path]:
    """Return the rig files, calm ones first."""
    return sorted(Path(__file__).parent.glob("*.toml"))
