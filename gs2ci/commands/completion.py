"""`gs2ci completion`: a script that lets a shell complete commands and their options.

Here: the scripts, made from the commands' signatures: no command is run or imported when a key is pressed. Not here:
the commands (`gs2ci.cli`).
"""

import importlib
import inspect
import re
import sys
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args, get_origin

import tyro

from gs2ci.api.derived import argument_texts

Shell = Literal["bash", "zsh", "fish"]

_HEAD: Final = "# Completion of gs2ci, written by `gs2ci completion {of}`. Write it again after an update.\n"
# A name of several words is one name.
_FILES_BY_BASH: Final = r"""local IFS=$'\n'; COMPREPLY=($(compgen -f -- "$word"))"""


@dataclass(frozen=True)
class CompletedOption:
    """An option as a shell completes it.

    Args:
        names: With dashes, the longest last.
        values: What may follow it; () for anything.
        files: Whether a path follows.
        bare: Whether nothing follows.
        help: One line.
    """

    names: tuple[str, ...]
    values: tuple[str, ...] = ()
    files: bool = False
    bare: bool = False
    help: str = ""


def run(shell: Annotated[Shell, tyro.conf.Positional], /) -> str:
    """Print a script that lets your shell complete commands, options and their values.

    Where each shell looks for it: docs/commands/completion.md.

    Args:
        shell: For which shell.

    Returns:
        The script.
    """
    from gs2ci.cli import COMMANDS

    about = {name: text for name, (_, text) in COMMANDS.items()}
    runs = {name: importlib.import_module(module).run for name, (module, _) in COMMANDS.items()}
    options = {name: options_of(command) for name, command in runs.items()}
    words = {name: found for name, command in runs.items() if (found := words_of(command))}
    made = {"bash": bash_script, "zsh": zsh_script, "fish": fish_script}[shell](about, options, words)
    sys.stdout.write(made)
    return made


def words_of(command: Any) -> tuple[str, ...]:
    """List what a command takes without an option where that is one of a few words; () where it is anything else."""
    hints = typing.get_type_hints(command, _names_of(command), include_extras=True)
    found: list[str] = []
    for name, parameter in inspect.signature(command).parameters.items():
        kind, marks = _unwrapped(hints.get(name, str))
        if _is_positional(parameter, marks) and get_origin(kind) is Literal:
            found += map(str, get_args(kind))
    return tuple(found)


def _is_positional(parameter: inspect.Parameter, marks: list[Any]) -> bool:
    return parameter.kind is parameter.POSITIONAL_ONLY or any("Positional" in repr(mark) for mark in marks)


def options_of(command: Any) -> list[CompletedOption]:
    """List a command's options from its signature, as the parser makes them."""
    hints = typing.get_type_hints(command, _names_of(command), include_extras=True)
    told = argument_texts(command)
    found = [CompletedOption(("-h", "--help"), bare=True, help="show help")]
    for name, parameter in inspect.signature(command).parameters.items():
        kind, marks = _unwrapped(hints.get(name, str))
        if _is_positional(parameter, marks):
            continue
        option = f"--{(_said(marks, 'name') or name).replace('_', '-')}"
        bare = kind is bool
        names = (*(_said(marks, "aliases") or ()), option)
        if bare and parameter.default is not False:  # it may be switched either way
            names = (*names, f"--no-{option[2:]}")
        values = tuple(str(value) for value in get_args(kind)) if get_origin(kind) is Literal else ()
        text = told.get(name) or _said(marks, "help") or ""
        found.append(CompletedOption(names, values, kind is Path, bare, _first_sentence(text)))
    return found


def _names_of(command: Any) -> dict[str, Any]:
    return dict(vars(inspect.getmodule(command)))


def _unwrapped(hint: Any) -> tuple[Any, list[Any]]:
    """Return a hint's kind, without None and Annotated, and what it is annotated with."""
    marks: list[Any] = []
    while get_origin(hint) is Annotated:
        hint, *more = get_args(hint)
        marks += more
    if get_origin(hint) is typing.Union or type(hint).__name__ == "UnionType":
        kinds = [kind for kind in get_args(hint) if kind is not type(None)]
        hint = kinds[0] if len(kinds) == 1 else hint
    return hint, marks


def _said(marks: list[Any], name: str) -> Any:
    return next((said for mark in marks if (said := getattr(mark, name, None))), None)


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=\.) ", text)[0].rstrip(".")


_Options = Mapping[str, list[CompletedOption]]
_Words = Mapping[str, tuple[str, ...]]


def bash_script(about: Mapping[str, str], options: _Options, words: _Words) -> str:
    """Return the script for bash.

    Args:
        about: Commands, and what each does.
        options: Of each.
        words: Of those that take one of a few words, these.
    """
    cases = []
    for command, listed in options.items():
        values = [
            f"        {'|'.join(one.names)}) COMPREPLY=($(compgen -W '{' '.join(one.values)}' -- \"$word\")); return;;"
            for one in listed
            if one.values
        ]
        files = "|".join(name for one in listed if one.files for name in one.names)
        if files:
            values.append(f"        {files}) {_FILES_BY_BASH}; return;;")
        names = " ".join(name for one in listed for name in one.names)
        taken = f" free='{' '.join(words[command])}'" if command in words else ""
        choice = "\n".join(['      case "$before" in', *values, "      esac"]) if values else ""
        cases.append(f"    {command})\n{choice}\n      words='{names}'{taken};;".replace("\n\n", "\n"))
    return "\n".join(
        [
            _HEAD.format(of="bash") + "_gs2ci() {",
            '  local word="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" words= free=',
            "  COMPREPLY=()",
            '  if [ "$COMP_CWORD" = 1 ]; then',
            f"    COMPREPLY=($(compgen -W '{' '.join(about)} --help --version' -- \"$word\")); return",
            "  fi",
            '  case "${COMP_WORDS[1]}" in',
            *cases,
            "  esac",
            '  if [[ "$word" == -* ]]; then COMPREPLY=($(compgen -W "$words" -- "$word"));',
            '  elif [ -n "$free" ]; then COMPREPLY=($(compgen -W "$free" -- "$word"));',
            f"  else {_FILES_BY_BASH}; fi",
            "}",
            "complete -o filenames -F _gs2ci gs2ci",
            "",
        ]
    )


def zsh_script(about: Mapping[str, str], options: _Options, words: _Words) -> str:
    """Return the script for zsh; the arguments are those of `bash_script`."""
    cases = []
    for command, listed in options.items():
        lines = []
        for one in listed:
            for name in one.names:
                after = "" if one.bare else ":value:_files" if one.files else f":value:({' '.join(one.values)})"
                after = after if one.bare or one.files or one.values else ":value: "
                lines.append(f"        '{name}[{_for_zsh(one.help)}]{after}'")
        free = f"'*:word:({' '.join(words[command])})'" if command in words else "'*:file:_files'"
        cases.append(
            "\n".join([f"      {command}) _arguments \\", " \\\n".join([*lines, f"        {free}"]), "      ;;"])
        )
    listing = "\n".join(f"    '{name}:{_for_zsh(text)}'" for name, text in about.items())
    return (
        f"#compdef gs2ci\n{_HEAD.format(of='zsh')}_gs2ci() {{\n  local -a commands\n  commands=(\n{listing}\n  )\n"
        "  if (( CURRENT == 2 )); then\n"
        "    if [[ $words[2] == -* ]]; then _arguments '--help[show help]' '--version[show the version]'\n"
        "    else _describe command commands; fi\n    return\n  fi\n"
        '  local command="$words[2]"\n  shift words; (( CURRENT-- ))\n'
        '  case "$command" in\n' + "\n".join(cases) + "\n  esac\n}\n"
        'if [ "$funcstack[1]" = _gs2ci ]; then _gs2ci "$@"; else compdef _gs2ci gs2ci; fi\n'
    )


def fish_script(about: Mapping[str, str], options: _Options, words: _Words) -> str:
    """Return the script for fish; the arguments are those of `bash_script`."""
    lines = [_HEAD.format(of="fish").rstrip()]
    lines += [
        f"complete -c gs2ci -n __fish_use_subcommand -l {name} -d '{text}'"
        for name, text in (("help", "show help"), ("version", "show the version"))
    ]
    lines += [
        f"complete -c gs2ci -n __fish_use_subcommand -f -a {name} -d '{_for_fish(text)}'"
        for name, text in about.items()
    ]
    lines += [
        f"complete -c gs2ci -n '__fish_seen_subcommand_from {command}' -f -a '{' '.join(found)}'"
        for command, found in words.items()
    ]
    for command, listed in options.items():
        for one in listed:
            names = [f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in one.names]
            after = (
                ""
                if one.bare
                else " -r -F"
                if one.files
                else f" -x -a '{' '.join(one.values)}'"
                if one.values
                else " -x"
            )
            seen = f"-n '__fish_seen_subcommand_from {command}'"
            lines.append(f"complete -c gs2ci {seen} {' '.join(names)}{after} -d '{_for_fish(one.help)}'")
    return "\n".join(lines) + "\n"


def _for_zsh(text: str) -> str:
    return re.sub(r"([\[\]:])", r"\\\1", text).replace("'", "'\\''")


def _for_fish(text: str) -> str:
    return text.replace("\\", "\\\\").replace("'", "\\'")
