"""Options of the whole test suite."""

from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--rig",
        type=Path,
        default=None,
        metavar="FILE",
        help="rig file of real devices on which tests/contracts/test_on_rig.py also runs; the stage moves by 1 mm",
    )
