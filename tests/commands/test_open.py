"""`gs2ci open` names the page that it opens, or what is wrong with the folder."""

import pytest

from gs2ci.api import runs
from gs2ci.commands import open_
from gs2ci.core.errors import StorageError


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("name", ["run", "run[draft]", "run[/x]"])
def test_the_page_is_named_whatever_its_path(tmp_path, monkeypatch, capsys, seen, name):
    opened = []
    monkeypatch.setattr(runs, "open_page", lambda page: opened.append(page) or seen)
    page = tmp_path / name / "report.html"
    page.parent.mkdir(parents=True)
    page.touch()
    assert open_.run(page.parent) == page
    assert opened == [page]
    said = capsys.readouterr().out
    assert said.startswith(str(page))
    assert ("no browser" in said) != seen


def test_what_is_no_folder_is_refused(tmp_path):
    with pytest.raises(StorageError, match="absent is no folder"):
        open_.run(tmp_path / "absent")
