"""A simulation's rig file read as `gs2ci plan` reads it."""

from pathlib import Path

from gs2ci.core.config import read_toml
from gs2ci_sims.rig_file import Setup, setup_from_tables


def read_rig_file(path: Path) -> Setup:
    """Read a rig file of a simulation."""
    return setup_from_tables(read_toml(path)[0], path)
