"""What is written for users keeps up with what there is."""

import re
from pathlib import Path

import pytest

from gs2ci import cli

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_readme_or_docs_tell_of_every_command(command):
    assert any(f"gs2ci {command}" in page.read_text(encoding="utf-8") for page in PAGES)


def test_readme_and_docs_name_no_command_that_does_not_exist():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = "\n".join(re.findall(r"^```.*?\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
        named = re.findall(r"^(?:\$ )?gs2ci ([a-z]\S*)", blocks, re.MULTILINE) + re.findall(r"`gs2ci ([a-z-]+)", text)
        assert set(named) <= set(cli.COMMANDS), page.name


@pytest.mark.parametrize("page", [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")], ids=lambda page: page.name)
def test_links_within_the_repository_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if "://" not in target and not target.startswith("mailto:"):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
