"""Every block of code in README and docs runs, or stands in a list with the reason why not.

A line of `gs2ci` is parsed by the command's own parser, which knows every option and refuses what is none; its work is
not done. Python is executed, TOML is read.
"""

import functools
import importlib
import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest

from gs2ci import cli
from gs2ci.core.storage import write_shots

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if "node_modules" not in p.parts)]
FENCED = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^ {4,}(?:\$ )?((?:gs2ci|python -m) .*(?:\\\n.*)*)", re.MULTILINE)

# Page and first words of a block of Python -> why it is not executed here.
NOT_RUN = {
    (
        "README.md",
        "import gs2ci\n\nshot = gs2ci.load(",
    ): "the first block of docs/python.md, for which see the next line",
    (
        "docs/python.md",
        "import gs2ci\n\nshot = gs2ci.load(",
    ): "tests/api/test_python_use.py makes these calls on a small shot",
    ("docs/python.md", "# shapes [H, W, C]"): "the same, with arrays",
    ("docs/python.md", "with gs2ci.open_rig("): "the same, on a simulated bench",
    ("docs/how-to.md", "from dataclasses import replace"): "tests/test_how_to.py runs it on a measurement and a log",
    ("docs/bluesky.md", "from bluesky import"): "tests/api/test_ophyd.py makes these calls on a simulated bench",
    ("docs/many.md", "from dask_jobqueue"): "needs Slurm; its syntax is checked",
}
# First words of a line of shell that is not ours -> why it is not run.
NOT_OURS = {
    "make": "tests/test_code_blocks.py looks for the target in the Makefile",
    "pip": "installs packages: `make wheel` does so",
    "dask": "starts servers: tests/batch/test_crew.py starts them from Python",
    "ssh": "needs a second machine",
    "pytest": "tests/test_plugin_template.py runs the template's tests",
    "python": "names of benchmarks and tests: tests/test_docs.py",
}


def name_of(page):
    return page.relative_to(ROOT).as_posix()


def blocks(language):
    return [
        pytest.param(page, text, id=f"{name_of(page)}-{text.split(maxsplit=1)[0] if text.split() else ''}-{number}")
        for page in PAGES
        for number, (found, text) in enumerate(FENCED.findall(page.read_text(encoding="utf-8")))
        if found == language
    ]


def shell_lines():
    """Return page and line of every line of shell, fenced or indented, continued lines joined."""
    found = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        fenced = [body for language, body in FENCED.findall(text) if language in ("", "sh", "console", "bash")]
        indented = INDENTED.findall(FENCED.sub("", text))
        for body in (*fenced, *indented):
            for line in re.sub(r"\\\n\s*", " ", body).splitlines():
                found.append((page, line.strip().removeprefix("$ ")))
    return found


def commands():
    """Return page and line of every line that calls gs2ci."""
    return [(name_of(page), line) for page, line in shell_lines() if re.match(r"gs2ci [a-z]", line)]


def is_taken(line):
    """Tell whether a command's own parser takes a line; its work is not done."""
    words = shlex.split(re.sub(r" {2,}.*| # .*| [>|] .*|\[(--?[a-z][^]]*)\]", r" \1", line).removesuffix("&").strip())
    module = importlib.import_module(cli.COMMANDS[words[1]][0])
    called = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(module, "run", functools.wraps(module.run)(lambda *_, **__: called.append(1)))
        patched.setattr(sys, "argv", words)
        try:
            status = cli.main()
        except SystemExit as end:
            status = end.code
            called.append("help" if "--help" in words else "refused")
    return status in (0, None) and bool(called)


def test_every_command_is_one_that_its_parser_takes():
    assert [(page, line) for page, line in commands() if not is_taken(line)] == []


def test_lines_that_are_not_ours_are_known():
    makefile = (ROOT / "Makefile").read_text()
    for page in PAGES:
        for language, body in FENCED.findall(page.read_text(encoding="utf-8")):
            for line in re.sub(r"\\\n\s*", " ", body).splitlines() if language in ("sh", "bash", "console") else ():
                first = line.strip().removeprefix("$ ").partition(" ")[0]
                assert not first or first in {"gs2ci", "#", *NOT_OURS}, f"{name_of(page)}: {line}"
    for page, line in shell_lines():
        for target in re.findall(r"^make ([a-z-]+)", line):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"{name_of(page)}: make {target}"


def test_toml_is_toml():
    for page in PAGES:
        for language, text in FENCED.findall(page.read_text(encoding="utf-8")):
            assert language != "toml" or tomllib.loads(text), name_of(page)


@pytest.mark.parametrize(("page", "text"), blocks("python"))
def test_python_runs(page, text, tmp_path, monkeypatch, random_shot):
    code = compile(text, name_of(page), "exec")
    if any(name_of(page) == where and text.startswith(first) for where, first in NOT_RUN):
        return
    monkeypatch.chdir(tmp_path)
    write_shots(tmp_path / "shot.h5", [random_shot])
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    exec(code, {"__name__": "__main__"})


def test_what_is_listed_as_not_run_is_there():
    texts = {name_of(page): page.read_text(encoding="utf-8") for page in PAGES}
    assert all(f"\n{first}" in texts[page] for page, first in NOT_RUN)
