"""The release checklist finds what is missing."""

import pytest

from gs2ci import __version__
from tests import release


@pytest.mark.parametrize("check", [release.package_version, release.cited_version])
def test_the_versions_of_this_commit_agree_and_another_is_refused(check):
    assert check(__version__) == ""
    assert check("99.0.0") != ""


def test_a_changelog_without_the_version_is_refused():
    assert release.changelog("99.0.0") == "CHANGELOG.md has none"


@pytest.mark.parametrize("arguments", [[], ["next"], ["1.2"], ["1.2.3", "more"]])
def test_what_is_no_version_is_refused(arguments, capsys):
    assert release.main(arguments) == 2
    assert "VERSION" in capsys.readouterr().err


def test_the_first_step_that_fails_ends_it(monkeypatch, capsys):
    done = []
    monkeypatch.setattr(
        release,
        "steps",
        lambda _: [
            ("one", lambda: done.append(1) or ""),
            ("two", lambda: "forgotten"),
            ("three", lambda: done.append(3) or ""),
        ],
    )
    assert release.main(["1.2.3"]) == 1
    assert done == [1]
    assert "not yet: forgotten" in capsys.readouterr().err


def test_when_all_is_done_it_says_what_is_left_to_a_person(monkeypatch, capsys):
    monkeypatch.setattr(release, "steps", lambda _: [("one", lambda: "")])
    assert release.main(["1.2.3"]) == 0
    assert "git tag -s v1.2.3" in capsys.readouterr().out


def test_a_wheel_of_another_version_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(release, "ROOT", tmp_path)
    (tmp_path / "dist").mkdir()
    assert "none" in release.wheel("1.2.3")
    (tmp_path / "dist" / "gs2ci-1.2.3-py3-none-any.whl").touch()
    assert release.wheel("1.2.3") == ""
