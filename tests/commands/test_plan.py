import io

import pytest
from rich.console import Console

from gs2ci.commands import plan
from gs2ci.core.errors import InputError

RIG = """
[scene]
height = 16
width = 24
[path]
parallax_px = 1.0
[modulator]
masks = 3
[effects.vignetting]
[effects.optics_psf]
sigma_px = 1e-6
[plan]
off = ["read_noise"]
"""


@pytest.fixture
def rig(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text(RIG, encoding="utf-8")
    return file


def test_every_effect_is_listed_with_its_bound_decision_and_reason(rig):
    console = Console(file=io.StringIO(), width=140)
    plan.print_plan(plan.plan_of(rig), console)
    lines = {line.split()[0]: line for line in console.file.getvalue().splitlines() if line.strip()}
    assert "exceeds its share" in lines["vignetting"]
    assert " no " in lines["optics_psf"]
    assert "forced off" in lines["read_noise"]
    assert "%" in lines["(views)"]
    assert "within" in lines["simulates"]


def test_no_title_is_cut_on_a_narrow_terminal(rig):
    console = Console(file=io.StringIO(), width=80)
    plan.print_plan(plan.plan_of(rig), console)
    assert console.file.getvalue().split()[:7] == ["effect", "DN", "rms", "simulated", "why", "samples", "time"]


def test_a_coarser_tolerance_on_the_command_line_goes_before_the_files(rig):
    assert len(plan.plan_of(rig, 100.0).effects) < len(plan.plan_of(rig).effects)


def test_a_forced_effect_that_is_not_there_is_refused(rig):
    rig.write_text(RIG.replace("read_noise", "red_noise"), encoding="utf-8")
    with pytest.raises(InputError, match="red_noise"):
        plan.run(rig)


@pytest.mark.parametrize("bench", ['name = "bench"\n[capture]\nmasks = 8\n', '[sensor]\nkind = "v4l2"\n'])
def test_the_rig_file_of_a_bench_is_answered_with_the_command_that_plans_it(tmp_path, bench):
    file = tmp_path / "bench.toml"
    file.write_text(bench, encoding="utf-8")
    with pytest.raises(InputError, match=r"describes a bench.*gs2ci capture --rig .*bench\.toml --dry-run"):
        plan.run(file)


@pytest.mark.parametrize("tolerance_dn", [0.0, -1.0, float("nan"), float("inf")])
def test_a_tolerance_that_is_none_is_refused_by_its_option(rig, tolerance_dn):
    with pytest.raises(InputError, match="--tolerance-dn"):
        plan.run(rig, tolerance_dn=tolerance_dn)


def test_with_rays_the_rasteriser_counts(rig):
    assert "drawn by rays" in plan.plan_of(rig, rays=True).summary()
    assert "drawn by rays" not in plan.plan_of(rig).summary()
    assert "drawn by rays" not in plan.plan_of(rig, 5000.0, rays=True).summary()
