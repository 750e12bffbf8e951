"""`pytest --skips FILE`: a skip that is not in the list fails the run. Without the option a skip stays a skip.

Here: the list, and what pytest asks of it. The list itself: `skips.toml`.
"""

import fnmatch
import tomllib
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import pytest

_KEYS = {"tests", "reason", "why", "lacking"}


@dataclass(frozen=True)
class Entry:
    """One kind of skip that is allowed; see `skips.toml`."""

    tests: str
    reason: str
    why: str
    lacking: str | None = None

    def allows(self, test: str, reason: str) -> bool:
        return fnmatch.fnmatchcase(test, self.tests) and reason.startswith(self.reason)


def load(path: Path, lacking: Collection[str]) -> list[Entry]:
    """Read the entries that hold on a machine that lacks these things.

    Raises:
        pytest.UsageError: The file is not such a list, or nothing in it is for what is lacking.
    """
    try:
        tables = tomllib.loads(path.read_text())["skip"]
        entries = [Entry(**table) for table in tables]
    except (OSError, tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise pytest.UsageError(f"{path} is no list of skips with the keys {sorted(_KEYS)}: {error}") from error
    unknown = set(lacking) - {entry.lacking for entry in entries}
    if unknown:
        raise pytest.UsageError(f"--lacking {sorted(unknown)}: no skip in {path} is for that")
    return [entry for entry in entries if entry.lacking is None or entry.lacking in lacking]


@dataclass(eq=False)  # pytest keeps its plugins in sets
class Skips:
    """Hears of every skip of a run, and ends it as failed where one is not allowed."""

    allowed: list[Entry]
    others: list[str] = field(default_factory=list)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.skipped and not hasattr(report, "wasxfail"):
            self._judge(report.nodeid, report.longrepr)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.skipped:
            self._judge(report.nodeid, report.longrepr)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self.others and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if self.others:
            terminalreporter.section("skips that are not in the list", red=True)
            for line in self.others:
                terminalreporter.line(line)

    def _judge(self, test: str, where: object) -> None:
        reason = str(where[2] if isinstance(where, tuple) else where).removeprefix("Skipped: ")
        if not any(entry.allows(test, reason) for entry in self.allowed):
            self.others.append(f"{test}: {reason}")
