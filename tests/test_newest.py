"""Which Python counts as the newest."""

import sys

import pytest

from tests import newest


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """Pythons that say which version they are, on the path and in a folder of pyenv."""

    def install(*versions, broken=()):
        for number, version in enumerate((*versions, *broken)):
            folder = tmp_path / (f"versions/{version}/bin" if number % 2 else "bin")
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"python{version}"
            answer = "exit 127" if version in broken else f"echo {version.replace('.', ' ')}"
            path.write_text(f"#!/bin/sh\n{answer}\n")
            path.chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path / "bin"))
        monkeypatch.setenv("PYENV_ROOT", str(tmp_path))

    return install


def test_the_newest_is_the_one_of_the_largest_number(installed):
    installed("3.9", "3.99", "3.100", "3.12")
    assert newest.newest().name == "python3.100"


def test_one_that_does_not_run_and_one_that_is_no_newer_do_not_count(installed):
    installed(f"3.{sys.version_info.minor}", "3.5", broken=("3.200",))
    assert newest.newest() is None
    assert newest.main() == 0
