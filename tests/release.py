"""`python -m tests.release VERSION`: the release checklist, each step done or looked at, in order; nothing is sent.

It stops at the first that fails, and says what to do. The last lines are what a person does: tag and upload.
"""

import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from gs2ci import __version__

ROOT = Path(__file__).resolve().parents[1]


def main(arguments: Sequence[str]) -> int:
    if len(arguments) != 1 or not re.fullmatch(r"\d+\.\d+\.\d+", arguments[0]):
        print("python -m tests.release VERSION, such as 0.2.0", file=sys.stderr)
        return 2
    version = arguments[0]
    for number, (what, step) in enumerate(steps(version), 1):
        print(f"{number}. {what}", flush=True)
        problem = step()
        if problem:
            print(f"   not yet: {problem}", file=sys.stderr)
            return 1
    print(f"All done. Now: git tag -s v{version} && git push --tags; upload dist/gs2ci-{version}*.")
    return 0


def steps(version: str) -> list[tuple[str, Callable[[], str]]]:
    """Return the checklist: what is looked at, and a function that returns what is wrong."""
    return [
        ("the version of the package", lambda: package_version(version)),
        ("the version that is to be cited", lambda: cited_version(version)),
        ("the changelog has a section of its own", lambda: changelog(version)),
        ("nothing is left uncommitted", clean),
        ("made pages are as the code makes them", lambda: succeeds("-m", "pytest", "-q", "tests/test_made_docs.py")),
        ("make check", lambda: made("check")),
        ("make test", lambda: made("test")),
        ("make docs", lambda: made("docs")),
        ("make wheel, with every dependency fetched", lambda: made("wheel")),
        ("the wheel has that version", lambda: wheel(version)),
    ]


def package_version(version: str) -> str:
    return "" if __version__ == version else f"gs2ci/__init__.py says {__version__}"


def cited_version(version: str) -> str:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    return "" if f"\nversion: {version}\n" in text else "CITATION.cff names another one"


def changelog(version: str) -> str:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    return "" if re.search(rf"^## .*{re.escape(version)}", text, re.MULTILINE) else "CHANGELOG.md has none"


def clean() -> str:
    left = subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return f"commit or remove: {left.strip()}" if left.strip() else ""


def succeeds(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, check=False)
    return "" if done.returncode == 0 else f"{' '.join(arguments)} fails"


def made(target: str) -> str:
    done = subprocess.run(["make", target], cwd=ROOT, check=False)
    return "" if done.returncode == 0 else f"make {target} fails"


def wheel(version: str) -> str:
    found = [path.name for path in (ROOT / "dist").glob("*.whl")]
    return "" if found == [f"gs2ci-{version}-py3-none-any.whl"] else f"dist/ holds {', '.join(found) or 'none'}"


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
