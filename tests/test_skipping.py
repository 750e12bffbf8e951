from pathlib import Path

import pytest

from tests.skipping import load

pytest_plugins = ["pytester"]

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / "tests" / "skips.toml"
CONFTEST = """
from pathlib import Path
from tests.skipping import Skips, load

def pytest_configure(config):
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Skips(load(Path("skips.toml"), LACKING)))
"""
TESTS = """
import pytest

def test_runs():
    pass

@pytest.mark.skipif(True, reason="no lens")
def test_needs_a_lens():
    pass

@pytest.mark.xfail(reason="known", strict=True)
def test_fails():
    assert False
"""
ALLOWED = '[[skip]]\ntests = "test_small.py::*"\nreason = "no lens"\nwhy = "it is elsewhere"\n'


@pytest.fixture
def small(pytester):
    """Run three small tests with a list of skips, on a machine that lacks some things."""

    def run(allowed, lacking, *options):
        pytester.makeconftest(CONFTEST.replace("LACKING", repr(lacking)))
        pytester.makepyfile(test_small=TESTS)
        pytester.makepyfile(**{"beside/conftest": "", "beside/test_beside": "def test_runs(): pass"})
        pytester.makefile(".toml", skips=allowed)
        pytester.makeini(f"[pytest]\npythonpath = {ROOT}\n")
        return pytester.runpytest("-p", "no:cacheprovider", *options)

    return run


@pytest.mark.parametrize(
    ("allowed", "lacking", "passes"),
    [
        (ALLOWED, [], True),
        (ALLOWED.replace("no lens", "no light"), [], False),
        (ALLOWED.replace("test_small", "test_other"), [], False),
        (ALLOWED + 'lacking = "lens"', ["lens"], True),
        (ALLOWED + 'lacking = "lens"', [], False),
    ],
)
def test_a_skip_that_is_not_allowed_fails_the_run(small, allowed, lacking, passes):
    done = small(allowed, lacking)
    assert done.ret == (pytest.ExitCode.OK if passes else pytest.ExitCode.TESTS_FAILED)
    assert ("test_small.py::test_needs_a_lens: no lens" in done.stdout.str()) != passes


def test_so_it_is_where_the_tests_run_in_processes_of_their_own(small):
    done = small(ALLOWED.replace("no lens", "no light"), [], "-n", "1")
    assert done.ret == pytest.ExitCode.TESTS_FAILED
    assert done.stdout.str().count("test_small.py::test_needs_a_lens: no lens") == 1


def test_entries_for_what_is_lacking_hold_only_where_it_is():
    everywhere = load(LIST, [])
    assert everywhere
    assert all(entry.lacking is None for entry in everywhere)
    assert len(load(LIST, ["chromium"])) > len(everywhere)


@pytest.mark.parametrize("text", ["[[skip]", "", "[[skip]]\ntests = 'x'", "[[skip]]\nwhatever = 1"])
def test_what_is_no_list_of_skips_is_refused(tmp_path, text):
    (tmp_path / "skips.toml").write_text(text)
    with pytest.raises(pytest.UsageError, match="is no list of skips"):
        load(tmp_path / "skips.toml", [])


def test_a_word_that_no_entry_knows_is_refused():
    with pytest.raises(pytest.UsageError, match="chromum"):
        load(LIST, ["chromum"])
