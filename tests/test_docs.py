"""What is written for users keeps up with what there is."""

import re
import sys
from pathlib import Path

import pytest

from gs2ci import cli
from gs2ci.core.plugins import GROUPS

ROOT = Path(__file__).resolve().parents[1]
SOURCES = {"gs2ci": ROOT, "gs2ci_drivers": ROOT / "drivers", "gs2ci_calibration": ROOT / "calibration"}
SOURCES |= {"gs2ci_sims": ROOT / "sims", "tests": ROOT}
FOLDERS = ("gs2ci", "drivers", "calibration", "sims", "tests", "docs")
WRITTEN = [
    *sorted(ROOT.glob("*.md")),
    *(path for name in FOLDERS for path in sorted((ROOT / name).rglob("*")) if path.suffix in {".py", ".md", ".toml"}),
]
# Pages that are made while the site is built (docs/site/pages.py).
MADE = {ROOT / "docs" / "reference" / name for name in ("commands.md", "python.md")}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def test_readme_or_docs_tell_of_every_command():
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    assert [name for name in cli.COMMANDS if not any(f"gs2ci {name}" in text for text in texts)] == []


def test_every_command_has_a_page_that_names_each_of_its_options(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "200")
    unnamed = {}
    for command in cli.COMMANDS:
        monkeypatch.setattr(sys, "argv", ["gs2ci", command, "--help"])
        with pytest.raises(SystemExit):
            cli.main()
        lines = re.findall(r"^[ │]*(--?\w.*)", capsys.readouterr().out, re.MULTILINE)
        options = [re.findall(r"--?[a-z][\w-]*", line) for line in lines]
        page = (ROOT / "docs" / "commands" / f"{command}.md").read_text(encoding="utf-8")
        named = set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", page)) | {"--help"}
        unnamed[command] = [names for names in options if not named & set(names)]
    assert {command: names for command, names in unnamed.items() if names} == {}


def test_readme_and_docs_name_no_command_that_does_not_exist():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = "\n".join(re.findall(r"^```.*?\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
        named = re.findall(r"^(?:\$ )?gs2ci ([a-z]\S*)", blocks, re.MULTILINE) + re.findall(r"`gs2ci ([a-z-]+)", text)
        assert set(named) <= set(cli.COMMANDS), page.name


def test_links_within_the_repository_lead_somewhere():
    dead = [
        f"{page.name} links to {target}"
        for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
        if "://" not in target and not target.startswith("mailto:")
        if not ((page.parent / target).exists() or page.parent / target in MADE)
    ]
    assert dead == []


def anchors(page):
    """Return what the headings of a page can be linked to by."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    plain = [
        re.sub(r"[^\w\s-]", "", heading).strip().lower() for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    ]
    return {re.sub(r"[-\s]+", "-", heading) for heading in plain} | set(re.findall(r"\{#([\w-]+)", text))


def test_links_to_headings_lead_to_one():
    dead = [
        f"{page.name} links to {target}#{heading}"
        for page in PAGES
        for target, heading in re.findall(r"\]\(([^)#\s:]*)#([^)\s]+)\)", page.read_text(encoding="utf-8"))
        if page.parent / target not in MADE and heading not in anchors(page.parent / target if target else page)
    ]
    assert dead == []


def test_the_navigation_names_every_page_and_no_other():
    """Those of commands and tutorials it finds itself (docs/site/pages.py)."""
    docs, navigation = ROOT / "docs", (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    named = set(re.findall(r"[\w./-]+\.md", navigation))
    by_itself = {f"commands/{name}.md" for name in cli.COMMANDS}
    pages = {path.relative_to(docs).as_posix() for path in (*docs.rglob("*.md"), *MADE)} - by_itself
    listed = {page for page in pages if not page.startswith(("decisions/", "plugin-template/"))}
    assert named - pages == set()
    assert listed - named == set()


def exists(module):
    """Tell whether a dotted name is a module of ours, or something that is named in one."""
    first, *rest = module.split(".")
    at = SOURCES[first] / first
    while rest and (at / rest[0]).is_dir():
        at /= rest.pop(0)
    if rest and (at / f"{rest[0]}.py").is_file():
        file, rest = at / f"{rest[0]}.py", rest[1:]
    else:
        file = at / "__init__.py"
    text = file.read_text(encoding="utf-8") if file.is_file() else ""
    return at.is_dir() and all(re.search(rf"\b{name}\b", text) for name in rest)


def test_files_that_are_named_anywhere_exist():
    # drivers/media/ is a folder of the Linux kernel, whose files are named as sources.
    named = re.compile(rf"(?<![\w./-])(?!drivers/media/)(?:{'|'.join(FOLDERS)})/[\w./-]*\w")
    missing = {
        (str(path.relative_to(ROOT)), name)
        for path in WRITTEN
        for name in named.findall(path.read_text(encoding="utf-8"))
        if not (ROOT / name).exists()
    }
    assert not missing


def test_modules_that_are_named_anywhere_exist():
    named = re.compile(rf"`((?:{'|'.join(SOURCES)})(?:\.\w+)+)`")
    missing = {
        (str(path.relative_to(ROOT)), name)
        for path in WRITTEN
        for name in named.findall(path.read_text(encoding="utf-8"))
        if name not in GROUPS and not exists(name)
    }
    assert not missing


def test_benchmarks_that_are_named_anywhere_exist():
    for path in WRITTEN:
        for words in re.findall(r"`python\s+-m\s+tests\.benchmarks\s+([^`]*)`", path.read_text(encoding="utf-8")):
            for name in words.partition(" --")[0].split():
                assert (ROOT / "tests" / "benchmarks" / f"{name}.py").is_file(), f"{path.name} names {name}"


DECISIONS = [path for path in sorted((ROOT / "docs" / "decisions").glob("*.md")) if path.name != "README.md"]


def test_every_decision_gives_decision_evidence_and_history_and_stands_in_the_index():
    index = (ROOT / "docs" / "decisions" / "README.md").read_text(encoding="utf-8")
    expected = (["Decision", "Evidence", "History"], ["Decision", "Evidence", "Not taken", "History"])
    wrong = {
        page.name: headings
        for page in DECISIONS
        if (headings := re.findall(r"^## (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)) not in expected
        or f"({page.name})" not in index
    }
    assert not wrong


def test_the_architecture_is_read_in_five_minutes():
    assert len((ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8").splitlines()) <= 150
