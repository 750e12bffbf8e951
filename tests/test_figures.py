"""Figures in README and docs: each table has a command that makes it, each command can be given, all data are known.

A table of scores says besides on what data they were taken, and of how many seeds they are.

Not here: whether the figures are right; who doubts them gives the command.
"""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from gs2ci_sims.scenes.files import scene_names
from tests.tables.catalogue import TABLES, TableOptions, chosen_cases
from tests.tables.literature import LEARNED

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "commands").glob("*.md"))]
DATA = (ROOT / "docs" / "data.md").read_text(encoding="utf-8")

COMMAND = re.compile(
    r"`(?:[A-Z0-9_]+=\S+ )*(?:gs2ci |python -m |make )|^ {4}(?:[A-Z0-9_]+=\S+ )*(?:gs2ci |python -m )", re.M
)
# A row of a table with at least one figure that was measured: a decimal number, mean and spread, or one in bold.
FIGURES = re.compile(r"^\|.*\|\s*\**[−-]?\d+\.\d+", re.M)
# A table whose columns judge a reconstruction: its figures depend on the scene, and on what was drawn.
SCORES = re.compile(r"\bdB\b|PSNR|SSIM|nATE")
TABLE = re.compile(r"(?:^\|.*\n?)+", re.M)
# How many draws a figure is of, in words or by the option that says it.
SEEDS = re.compile(
    r"\b(?:one|two|three|four|five|six|seven|ten|\d+)\s+(?:seeds?|draws?|exposures?)\b|nothing is drawn"
    r"|--seeds \d|GS2CI_SEEDS=|\bseed \d",
    re.I,
)
# What data are, where they are not named as docs/data.md names them.
ORIGIN = re.compile(
    r"\bsimulat|\brender(?:ed|ing)|\bphotograph|\bpath-traced\b|\bhardware (?:exposure|measurement)", re.I
)
# Constants and settings, which nobody measured.
CONSTANTS = {("paper-preset.md", "Constants"), ("paper-preset.md", "Where the paper says nothing")}


def parts(page):
    """The page's beginning, and each of its sections with its title."""
    beginning, *sections = re.split(r"^## ", page.read_text(encoding="utf-8"), flags=re.M)
    return beginning, [(section.splitlines()[0], section) for section in sections]


def test_each_table_of_figures_names_the_command_that_makes_it():
    without = []
    for page in PAGES:
        beginning, sections = parts(page)
        for title, section in sections:
            if len(FIGURES.findall(section)) < 2 or (page.name, title) in CONSTANTS:
                continue
            # One command may make all tables of a page: then the page begins with it.
            if not (COMMAND.search(section) or COMMAND.search(beginning)):
                without.append(f"{page.name}: {title}")
    assert without == []


def test_what_counts_as_a_table_of_figures_finds_those_that_there_are():
    found = [page.name for page in PAGES if any(len(FIGURES.findall(text)) > 1 for _, text in parts(page)[1])]
    assert {"README.md", "comparisons.md", "stability.md", "calibration.md", "tables.md"} & set(found) == {
        *("README.md", "comparisons.md", "stability.md", "calibration.md"),
    }
    assert not COMMAND.search("a sentence about `gs2ci`, its make and python")


def described():
    """The names that docs/data.md has for data, in the first column of its table."""
    rows = re.findall(r"^\|([^|]*)\|", DATA, re.M)
    return {name.strip("` ") for row in rows for name in re.split(r",|\band\b", row)} - {"", "---", "measurement"}


def scores_without_word(text):
    """What each table of scores in a page does not say: its data, its seeds. It may stand in the page's beginning.

    What belongs to a table is what stands around it, up to the tables before and after it and within its section.
    """
    beginning, *sections = re.split(r"^## ", text, flags=re.M)
    found = []
    for section in sections:
        tables = list(TABLE.finditer(section))
        for before, table, after in zip([None, *tables], tables, [*tables[1:], None], strict=False):
            header = table[0].splitlines()[0]
            if not SCORES.search(header) or len(FIGURES.findall(table[0])) < 2:
                continue
            near = section[before.end() if before else 0 : after.start() if after else None]
            said = f"{TABLE.sub('', beginning)}\n{near}"
            named = any(re.search(rf"(?<!\w){re.escape(name)}(?!\w)", said) for name in described())
            missing = [] if named or ORIGIN.search(said) else ["data"]
            missing += [] if SEEDS.search(said) else ["seeds"]
            found += [f"{section.splitlines()[0]}: {header}: {', '.join(missing)}"] if missing else []
    return found


def test_each_table_of_scores_says_its_data_and_its_seeds():
    found = {page.name: scores_without_word(page.read_text(encoding="utf-8")) for page in PAGES}
    assert {name: missing for name, missing in found.items() if missing} == {}


CLAIM = "## Figures\n\n{}\n\n| | PSNR, dB |\n|---|---:|\n| default | 31.25 |\n| other | **30.1** |\n"


@pytest.mark.parametrize(
    ("words", "missing"),
    [
        ("`python -m tests.tables seeds --cases boxes --seeds 3`:", ""),
        ("Photographs on planes, one seed:", ""),
        ("`python -m tests.tables seeds --cases boxes`:", "seeds"),
        ("The default ends where seeds and scenes agree:", "data, seeds"),
        ("Three seeds, a fernlike scene:", "data"),
        ("Better on every scene, by far:", "data, seeds"),
    ],
)
def test_a_table_of_scores_without_data_or_seeds_is_found(words, missing):
    found = scores_without_word(CLAIM.format(words))
    assert [one.rpartition(": ")[2] for one in found] == ([missing] if missing else [])
    # The word about one table is none about the next, and what the page's beginning says is for all.
    two = CLAIM.format("Photographs on planes, one seed:") + "\nAnd:\n" + CLAIM.format(words).partition("\n\n")[2]
    assert len(scores_without_word(two)) <= 1
    assert not scores_without_word("Simulated scenes, two seeds.\n\n" + CLAIM.format(words))
    costs = CLAIM.format(words).replace("PSNR, dB", "seconds")
    assert not scores_without_word(costs)


def named_tables():
    """Every `python -m tests.tables` with options that a page names: page, table, and its lines and cases."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        given = re.findall(r"`python -m tests.tables ([a-z-]+[^`]*)`", text) + re.findall(
            r"^ {4}python -m tests.tables (\S.*)$", text, re.M
        )
        for words in map(shlex.split, given):
            options: dict[str, list[str]] = {"": []}
            for word in words[1:]:
                if word.startswith("-"):
                    key = word
                    options[key] = []
                elif len(options) > 1:
                    options[key].append(word)
            yield f"{page.name}: {' '.join(words)}", words[0], options


GIVEN = {
    "",
    "--mechanisms",
    "--only",
    "--lines",
    "--cases",
    "--data",
    "--size",
    "--seeds",
    "--processes",
    "-o",
    "--output",
}


def cannot_be_made(table, options):
    """What is wrong with a table and its options, "" if nothing is."""
    if table not in TABLES or not set(options) <= GIVEN:
        return f"no such table or option: {table} {set(options) - GIVEN}"
    if "--data" in options or table == "simulate":
        cases = ()
    else:
        cases = chosen_cases(table, None, None, options.get("--cases", []))
    # Lines of models need the models, and their names are all that is to be known of them.
    lines = tuple(line for line in options.get("--lines", []) if line not in LEARNED)
    entries = TABLES[table].entries(TableOptions(cases, seeds=1, lines=lines))
    missing = set(lines) - {entry.line for entry in entries}
    return f"no lines {missing}" if missing and cases else ""


def test_tables_that_are_named_can_be_made():
    wrong = {where: cannot_be_made(table, options) for where, table, options in named_tables()}
    assert {where: what for where, what in wrong.items() if what} == {}


def test_data_that_pages_name_are_described():
    known = set(re.findall(r"`(\w+)`", "\n".join(re.findall(r"^\|[^|]*\|", DATA, re.M))))
    named = {
        (page.name, name)
        for page in PAGES
        for name in re.findall(r"`(fern_\w+|real_\w+|video_sci|lightfield)`", page.read_text(encoding="utf-8"))
    }
    assert {one for one in named if one[1] not in known} == set()


def test_scenes_of_triangles_are_not_called_gaussians():
    library = ROOT / "sims" / "gs2ci_sims" / "scenes" / "library"
    kinds = {path.stem: tomllib.loads(path.read_text("utf-8"))["geometry"]["kind"] for path in library.glob("*.toml")}
    assert set(kinds) == set(scene_names())
    meshes = {name for name, kind in kinds.items() if kind in ("blocks", "mesh")}
    assert meshes == {"blocks", "glossy"}
    rows = [row for row in DATA.splitlines() if row.startswith("|")]
    assert [all(name in row for name in meshes) for row in rows if "triangles" in row] == [True]
    assert not any(re.search(r"all scenes of the simulator's library are Gaussians", line, re.I) for line in rows)
