"""The documentation site builds strictly, and fetches nothing when it is read."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gs2ci
from gs2ci import cli

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.slow
pytest.importorskip("mkdocs", reason="the extra docs is not installed")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_no_page_fetches_anything_from_elsewhere(site):
    for page in site.rglob("*.html"):
        for tag in re.findall(r"<(?:script|link|img|iframe)[^>]*>", page.read_text(encoding="utf-8")):
            address = re.search(r"(?:src|href)=[\"\']?([^\"\' >]+)", tag)
            assert address is None or not re.match(r"(?:https?:)?//", address[1]), f"{page.name}: {tag}"


def test_the_reference_has_every_command_and_every_public_name(site):
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    assert [name for name in cli.COMMANDS if f">gs2ci {name}<" not in commands] == []
    names = (site / "reference" / "python.html").read_text(encoding="utf-8")
    assert [name for name in gs2ci.__all__ if not name.startswith("__") and f".{name}" not in names] == []
    assert "<h2" in names


def test_every_command_has_its_page_in_the_navigation(site):
    page = (site / "index.html").read_text(encoding="utf-8")
    assert [name for name in cli.COMMANDS if f"commands/{name}.html" not in page] == []


def test_schemas_lie_beside_the_pages(site):
    assert {path.name for path in site.glob("*.schema.json")} >= {"report.schema.json", "shot.schema.json"}


def test_every_notebook_has_a_page_with_its_words_and_code_and_a_link_to_itself(site):
    notebooks = sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))
    assert notebooks
    for notebook in notebooks:
        page = (site / "tutorials" / f"{notebook.stem}.html").read_text(encoding="utf-8")
        assert f'href="{notebook.name}"' in page
        assert (site / "tutorials" / notebook.name).is_file()
        assert "<pre" in page
    assert "tutorials/1-first-scene.html" in (site / "python.html").read_text(encoding="utf-8")
