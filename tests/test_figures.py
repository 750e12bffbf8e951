"""Figures in README and docs: each table has a command that makes it, each command can be given, all data are known.

Not here: whether the figures are right; who doubts them gives the command.
"""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from gs2ci.tables.catalogue import TABLES, TableOptions, chosen_cases
from gs2ci.tables.literature import LEARNED
from gs2ci_sims.scenes.files import scene_names

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "commands").glob("*.md"))]
DATA = (ROOT / "docs" / "data.md").read_text(encoding="utf-8")

COMMAND = re.compile(
    r"`(?:[A-Z0-9_]+=\S+ )*(?:gs2ci |python -m |make )|^ {4}(?:[A-Z0-9_]+=\S+ )*(?:gs2ci |python -m )", re.M
)
# A row of a table with at least one figure that was measured: a decimal number, mean and spread, or one in bold.
FIGURES = re.compile(r"^\|.*\|\s*\**[−-]?\d+\.\d+", re.M)
# Constants and settings, which nobody measured.
CONSTANTS = {("paper-preset.md", "Constants"), ("paper-preset.md", "Where the paper says nothing")}


def parts(page):
    """The page's beginning, and each of its sections with its title."""
    beginning, *sections = re.split(r"^## ", page.read_text(encoding="utf-8"), flags=re.M)
    return beginning, [(section.splitlines()[0], section) for section in sections]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_each_table_of_figures_names_the_command_that_makes_it(page):
    beginning, sections = parts(page)
    for title, section in sections:
        if len(FIGURES.findall(section)) < 2 or (page.name, title) in CONSTANTS:
            continue
        # One command may make all tables of a page: then the page begins with it.
        assert COMMAND.search(section) or COMMAND.search(beginning), title


def test_what_counts_as_a_table_of_figures_finds_those_that_there_are():
    found = [page.name for page in PAGES if any(len(FIGURES.findall(text)) > 1 for _, text in parts(page)[1])]
    assert {"README.md", "comparisons.md", "stability.md", "calibration.md", "tables.md"} & set(found) == {
        *("README.md", "comparisons.md", "stability.md", "calibration.md"),
    }
    assert not COMMAND.search("a sentence about `gs2ci`, its make and python")


def named_tables():
    """Every `gs2ci tables` with options that a page names: page, table, and its lines and cases."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        given = re.findall(r"`gs2ci tables ([a-z-]+[^`]*)`", text) + re.findall(
            r"^ {4}gs2ci tables (\S.*)$", text, re.M
        )
        for words in map(shlex.split, given):
            options: dict[str, list[str]] = {"": []}
            for word in words[1:]:
                if word.startswith("-"):
                    key = word
                    options[key] = []
                elif len(options) > 1:
                    options[key].append(word)
            yield pytest.param(words[0], options, id=f"{page.name}: {' '.join(words)}")


@pytest.mark.parametrize(("table", "options"), list(named_tables()))
def test_a_table_that_is_named_can_be_made(table, options):
    assert table in TABLES
    assert set(options) <= {"", "--lines", "--cases", "--data", "--size", "--seeds", "--processes", "-o", "--output"}
    if "--data" in options or table == "simulate":
        cases = ()
    else:
        cases = chosen_cases(table, None, None, options.get("--cases", []))
    # Lines of models need the models, and their names are all that is to be known of them.
    lines = tuple(line for line in options.get("--lines", []) if line not in LEARNED)
    entries = TABLES[table].entries(TableOptions(cases, seeds=1, lines=lines))
    assert {entry.line for entry in entries} >= set(lines) or not cases


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_data_that_a_page_names_are_described(page):
    named = set(re.findall(r"`(fern_\w+|real_\w+|video_sci|lightfield)`", page.read_text(encoding="utf-8")))
    described = set(re.findall(r"`(\w+)`", "\n".join(re.findall(r"^\|[^|]*\|", DATA, re.M))))
    assert named <= described


def test_scenes_of_triangles_are_not_called_gaussians():
    library = ROOT / "sims" / "gs2ci_sims" / "scenes" / "library"
    kinds = {path.stem: tomllib.loads(path.read_text("utf-8"))["geometry"]["kind"] for path in library.glob("*.toml")}
    assert set(kinds) == set(scene_names())
    meshes = {name for name, kind in kinds.items() if kind in ("blocks", "mesh")}
    assert meshes == {"blocks", "glossy"}
    rows = [row for row in DATA.splitlines() if row.startswith("|")]
    assert [all(name in row for name in meshes) for row in rows if "triangles" in row] == [True]
    assert not any(re.search(r"all scenes of the simulator's library are Gaussians", line, re.I) for line in rows)
