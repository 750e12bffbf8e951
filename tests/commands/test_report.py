import numpy as np
import pytest
import tyro

from gs2ci.commands import reconstruct, report
from gs2ci.core.errors import StorageError
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage import write_shots


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of the whole way, as short as it can be."""
    place = tmp_path_factory.mktemp("report")
    rng = np.random.default_rng(0)
    views = np.repeat(rng.random((3, 24, 32, 1)), 3, axis=3).astype(np.float32)
    masks = np.tile((np.arange(3)[:, None, None] == (np.arange(32) % 3)), (1, 24, 1)).astype(np.float32)
    shot = Shot((masks[..., None] * views).sum(axis=0), masks, np.ones(3, np.float32), truth=Truth(views), name="noise")
    return reconstruct.run(write_shots(place / "shot.h5", [shot]), place / "run", iterations=2)


def test_reconstruct_writes_the_page_and_says_where(folder, capsys):
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert "3 views" in text
    assert '<h2 id="views-title">Views</h2>' in text


def test_the_page_is_written_again_and_named(folder, capsys):
    before = (folder / "report.html").read_bytes()
    (folder / "report.html").unlink()
    assert tyro.cli(report.run, args=[str(folder)]) == folder / "report.html"
    assert (folder / "report.html").read_bytes() == before
    assert f"{folder / 'report.html'}  0.2 MB, one file" in capsys.readouterr().out


def test_the_page_can_go_elsewhere(folder, tmp_path):
    assert tyro.cli(report.run, args=[str(folder), "-o", str(tmp_path / "page.html")]) == tmp_path / "page.html"
    assert (tmp_path / "page.html").stat().st_size > 10_000


@pytest.mark.parametrize("content", [b"", b"my notes", b"<!doctype html><title>mine</title>"])
def test_only_an_earlier_page_is_replaced(folder, tmp_path, content):
    page = tmp_path / "page.html"
    page.write_bytes(content)
    with pytest.raises(StorageError, match=r"page\.html exists and is not a page of gs2ci"):
        report.run(folder, page)
    with pytest.raises(StorageError, match=r"shot\.h5 exists and is not a page of gs2ci"):
        report.run(folder, folder.parent / "shot.h5")
    assert page.read_bytes() == content
    page.unlink()
    assert report.run(folder, page).read_bytes() == report.run(folder, page).read_bytes()


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(StorageError, match="gs2ci reconstruct -o"):
        report.run(tmp_path)
    assert not list(tmp_path.iterdir())
