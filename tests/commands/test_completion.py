"""Scripts for shells, tried in the shells that are here."""

import importlib
import re
import shutil
import subprocess
import sys

import pytest

from gs2ci import cli
from gs2ci.commands import completion
from gs2ci.commands.reconstruct import run as reconstruct


@pytest.fixture(scope="module")
def scripts():
    return {shell: completion.run(shell) for shell in ("bash", "zsh", "fish")}


def bash_completes(script, *words):
    """Return what bash offers for the last word."""
    line = " ".join(f"'{word}'" for word in words)
    code = f"{script}\nCOMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _gs2ci; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(["bash", "--norc", "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return [line for line in done.stdout.split("\n") if line]


def test_bash_completes_commands(scripts):
    assert bash_completes(scripts["bash"], "gs2ci", "rec") == ["reconstruct", "recover"]


def test_bash_completes_options_of_the_command_alone(scripts):
    assert bash_completes(scripts["bash"], "gs2ci", "reconstruct", "--se") == ["--seed"]
    assert bash_completes(scripts["bash"], "gs2ci", "recover", "--se") == []


def test_bash_completes_values_that_are_fixed(scripts):
    assert bash_completes(scripts["bash"], "gs2ci", "reconstruct", "x.h5", "--preset", "s") == ["standard"]


def test_bash_completes_words_that_a_command_takes_without_an_option(scripts, tmp_path, monkeypatch):
    """It listed files (E7)."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "zebra.h5").touch()
    assert bash_completes(scripts["bash"], "gs2ci", "completion", "") == ["bash", "zsh", "fish"]
    assert bash_completes(scripts["bash"], "gs2ci", "completion", "z") == ["zsh"]
    assert bash_completes(scripts["bash"], "gs2ci", "completion", "-") == ["-h", "--help"]


def test_words_without_an_option_are_in_every_script(scripts):
    for command, (module, _) in cli.COMMANDS.items():
        for word in completion.words_of(importlib.import_module(module).run):
            assert bash_completes(scripts["bash"], "gs2ci", command, word) == [word]
            assert re.search(rf"'\*:word:\([^)]*\b{word}\b", scripts["zsh"])
            assert re.search(rf"__fish_seen_subcommand_from {command}' -f -a '[^']*\b{word}\b", scripts["fish"])


def test_every_shell_knows_the_options_without_a_command(scripts):
    assert bash_completes(scripts["bash"], "gs2ci", "--v") == ["--version"]
    assert "__fish_use_subcommand -l version" in scripts["fish"]
    assert "--version[" in scripts["zsh"]


def test_help_is_a_whole_sentence():
    assert completion._first_sentence("Of a thing; and of another: both. More.") == "Of a thing; and of another: both"


def test_bash_completes_files_else(scripts, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("shot.h5", "my first shot.h5"):
        (tmp_path / name).touch()
        assert bash_completes(scripts["bash"], "gs2ci", "reconstruct", name[:2]) == [name]
        assert bash_completes(scripts["bash"], "gs2ci", "reconstruct", "x.h5", "-o", name[:2]) == [name]


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_every_command_and_option_stands_in_the_script(scripts, shell):
    for command, (_, about) in cli.COMMANDS.items():
        assert command in scripts[shell]
        assert about.split(":")[0].split("'")[0] in scripts[shell]
    assert "focal-px" in scripts[shell]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_is_sound_by_its_own_shell(scripts, shell):
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} on this machine")
    done = subprocess.run([shell, "-n"], input=scripts[shell], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_the_options_are_those_of_the_parser(command, monkeypatch, capsys):
    """The parser refuses an option that it does not know before anything else."""
    monkeypatch.setattr(sys, "argv", ["gs2ci", command, "--help"])
    monkeypatch.setenv("COLUMNS", "300")
    with pytest.raises(SystemExit):
        cli.main()
    said = {
        name
        for line in re.findall(r"^[ │]{0,3}(--?[a-z].*)", capsys.readouterr().out, re.MULTILINE)
        for name in re.findall(r"(?<![\w-])--?[a-z][\w-]*", re.split(r"  ", line)[0])
    }
    options = completion.options_of(importlib.import_module(cli.COMMANDS[command][0]).run)
    assert {name for option in options for name in option.names} <= said
    assert {name for name in said if name.startswith("--") and not name.startswith("--no-")} <= {
        name for option in options for name in option.names
    }


def test_texts_and_kinds_are_read_from_the_command():
    options = {one.names[-1]: one for one in completion.options_of(reconstruct)}
    assert options["--output"].files
    assert options["--output"].names == ("-o", "--output")
    assert options["--overwrite"].bare
    assert options["--all"].bare
    assert options["--seed"].help.startswith("Seed of every random draw")
