"""Commands as a user types them, in a folder with a rig file: the text `RIG` of the module that asks for it."""

import sys

import pytest

from gs2ci import cli


@pytest.fixture
def rig(tmp_path, monkeypatch, request):
    path = tmp_path / "rig.toml"
    path.write_text(request.module.RIG)
    monkeypatch.chdir(tmp_path)
    return path


@pytest.fixture
def gs2ci(monkeypatch):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["gs2ci", *map(str, arguments)])
        return cli.main()

    return run
