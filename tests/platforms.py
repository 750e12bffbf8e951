"""`python -m tests.platforms`: whether all that gs2ci needs can be had, as wheels, for other machines and Pythons.

Asks pip, as a user's would be asked there, without constraints; nothing is installed. What is needed is read from the
metadata of what is installed here, with the markers as the other machine would evaluate them: pip itself evaluates them
for this one, whatever platform it is told.
"""

import argparse
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Target:
    """A kind of machine and a Python.

    Args:
        machine: As `uname -m` says.
        python: Its version, two numbers.
        extras: Of gs2ci.
    """

    machine: str
    python: str
    extras: tuple[str, ...]


# Python 3.14 has all; of 3.15 several wheels are missing so far.
TARGETS = (
    Target("aarch64", "3.11", ("reconstruct", "view", "cluster")),
    Target("aarch64", "3.13", ("reconstruct",)),
    Target("x86_64", "3.14", ("reconstruct", "mesh", "view")),
)


def needed(target: Target) -> dict[str, str]:
    """Return what gs2ci and its extras need there: names, each with the versions that gs2ci itself allows."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [
        *project["dependencies"],
        *(line for one in target.extras for line in project["optional-dependencies"][one]),
    ]
    found: dict[str, str] = {}
    waiting = [Requirement(line) for line in lines]
    while waiting:
        one = waiting.pop(0)
        if one.name == "gs2ci":
            waiting += [Requirement(line) for extra in one.extras for line in project["optional-dependencies"][extra]]
            continue
        if not _holds(one, target, "") or one.name.lower() in found:
            continue
        found[one.name.lower()] = f"{one.name}{one.specifier}" if str(one) in lines else one.name
        waiting += [
            other for other in _requirements(one.name) if any(_holds(other, target, e) for e in ("", *one.extras))
        ]
    return found


def _holds(requirement: Requirement, target: Target, extra: str) -> bool:
    if requirement.marker is None:
        return True
    return requirement.marker.evaluate(
        {
            "extra": extra,
            "platform_machine": target.machine,
            "python_version": target.python,
            "python_full_version": f"{target.python}.0",
        }
    )


def _requirements(name: str) -> Iterator[Requirement]:
    try:
        yield from (Requirement(line) for line in requires(name) or ())
    except PackageNotFoundError:
        return


def lacking(target: Target) -> str:
    """Ask pip; return what it says is lacking, "" if nothing."""
    glibc = [f"--platform=manylinux{each}_{target.machine}" for each in ("2014", "_2_17", "_2_27", "_2_28", "_2_34")]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--no-deps", "--ignore-installed"]
        command += ["--only-binary=:all:", *glibc, f"--python-version={target.python}", f"--target={folder}"]
        done = subprocess.run([*command, *needed(target).values()], capture_output=True, text=True, check=False)
    said = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
    return "" if done.returncode == 0 else "\n".join(said) or done.stderr


def main(arguments: Sequence[str]) -> int:
    """Ask for each target, or for those of a machine; return how many lack something."""
    parser = argparse.ArgumentParser(prog="python -m tests.platforms")
    parser.add_argument("machines", nargs="*", help="aarch64 or x86_64; by default both")
    chosen = parser.parse_args(arguments).machines
    failed = 0
    for target in TARGETS:
        if chosen and target.machine not in chosen:
            continue
        problem = lacking(target)
        failed += bool(problem)
        print(
            f"{target.machine}, Python {target.python}, {', '.join(target.extras)}: {problem or 'all there'}",
            flush=True,
        )
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
