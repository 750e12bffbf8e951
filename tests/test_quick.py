"""Which tests `make quick` chooses, and which wait for the night."""

from tests import quick
from tests.nightly import but, but_one_of_each


def test_a_changed_module_is_tested_by_what_imports_it():
    chosen = {path.name for path in quick.chosen(["gs2ci/reconstruct/registration/widening.py"])}
    assert "test_widening.py" in chosen
    assert "test_ply.py" not in chosen


def test_a_changed_test_is_run_itself_and_pages_are_looked_at():
    assert [path.name for path in quick.chosen(["tests/test_quick.py"])] == ["test_quick.py"]
    assert quick.ROOT / "tests" / "test_docs.py" in quick.chosen(["docs/bench.md"])


def test_sources_of_all_four_roots_are_modules():
    assert quick.module_of("drivers/gs2ci_drivers/zaber/driver.py") == "gs2ci_drivers.zaber.driver"
    assert quick.module_of("gs2ci/core/__init__.py") == "gs2ci.core"
    assert quick.module_of("docs/site/pages.py") == ""


def test_one_of_each_family_runs_with_every_commit():
    cases = but_one_of_each(lambda text: text[0], ["a1", "a2", "b1"])
    assert [case for case in cases if isinstance(case, str)] == ["a1", "b1"]
    assert [case for case in but(1, "xyz") if isinstance(case, str)] == ["x"]
