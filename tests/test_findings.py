"""Scripts in `findings/` have one form: what they install is pinned, and they leave nothing behind.

Not here: what they show; they install packages, which the tests do not.
"""

import os
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "findings"
# Folders in which people work, and which others do not have.
OF_ONE_MACHINE = ("work", "home", "root")
# The namespace by which GenApi knows a camera's description: a name, though it looks like an address.
GENAPI = 'xmlns="http://www.genicam.org/GenApi/Version_1_1"'
SCRIPTS = sorted(FOLDER.glob("*.sh"))


def test_the_page_says_what_they_are_and_names_each_once():
    text = (FOLDER / "README.md").read_text()
    assert text.startswith(
        "What real libraries do that a good guess has wrong; each script installs pinned public packages"
    )
    assert sorted(re.findall(r"\[[^\]]*\]\(([\w.-]+\.sh)\)", text)) == [path.name for path in SCRIPTS]
    assert len(SCRIPTS) >= 5


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_finding_is_pinned_tells_what_was_guessed_and_cleans_up(path):
    text = path.read_text()
    assert os.access(path, os.X_OK)
    lines = text.splitlines()
    assert lines[0] == "#!/usr/bin/env bash"
    assert "set -euo pipefail" in lines
    assert "mktemp -d" in text
    assert "trap 'rm -rf" in text
    assert "good guess" in " ".join(line.removeprefix("# ") for line in lines if line.startswith("# "))
    wanted = re.findall(r"(?:pip|npm)\"? install(.*)", text)
    assert wanted
    named = [word for line in wanted for word in line.split(">")[0].split() if not word.startswith("-")]
    assert named
    assert all(re.fullmatch(r"[\w.-]+(\[[\w,-]+\])?==[\w.]+|@?[\w./-]+@\d[\w.-]*", word) for word in named), named
    assert not re.search(r"gs2ci|https?://|index-url", text.replace(GENAPI, ""))
    assert not any(f"/{folder}" in text for folder in OF_ONE_MACHINE)
    assert re.search(r"sys\.exit\(|exit 1|process\.exit|^assert .*has changed", text, re.MULTILINE)
