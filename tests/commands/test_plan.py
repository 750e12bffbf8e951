import io
import json
import re
from pathlib import Path

import pytest
from rich.console import Console

from gs2ci.api.plans import plan as plan_of
from gs2ci.api.sweeps import TRAVEL_KEY, sweep
from gs2ci.commands import plan
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.progress import Silent
from gs2ci.rig.opening import load_rig
from gs2ci.rig.recording import prepare, record

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
    plan.print_plan(plan_of(rig), console)
    lines = {line.split()[0]: line for line in console.file.getvalue().splitlines() if line.strip()}
    assert "exceeds its share" in lines["vignetting"]
    assert " no " in lines["optics_psf"]
    assert "forced off" in lines["read_noise"]
    assert "%" in lines["(views)"]
    assert "within" in lines["simulates"]


def test_no_title_is_cut_on_a_narrow_terminal(rig):
    console = Console(file=io.StringIO(), width=80)
    plan.print_plan(plan_of(rig), console)
    assert console.file.getvalue().split()[:7] == ["effect", "DN", "rms", "simulated", "why", "samples", "time"]


@pytest.mark.parametrize("width", [60, 72, 80])
def test_no_name_and_no_number_is_cut_on_a_narrow_terminal(rig, width):
    wide, narrow = (Console(file=io.StringIO(), width=columns) for columns in (200, width))
    decided = plan_of(rig)
    for console in (wide, narrow):
        plan.print_plan(decided, console)
    told = narrow.file.getvalue()
    assert "…" not in told
    for line in wide.file.getvalue().splitlines()[1:]:
        figures = [word for word in line.split() if word[0].isdigit()] if "within" not in line else []
        assert {line.split()[0], *figures} <= set(told.split()), line


def test_a_coarser_tolerance_on_the_command_line_goes_before_the_files(rig):
    assert len(plan_of(rig, 100.0).effects) < len(plan_of(rig).effects)


def test_a_forced_effect_that_is_not_there_is_refused(rig):
    rig.write_text(RIG.replace("read_noise", "red_noise"), encoding="utf-8")
    with pytest.raises(InputError, match="red_noise"):
        plan.run(rig)


BENCH = """
[modulator]
kind = "scpi"
[sensor]
kind = "v4l2"
height = 40
width = 60
format = "Y12"
[stage]
kind = "zaber"
[stage.mount]
[capture]
masks = 3
mask_s = 0.03
axis = "x"
from_mm = 74.0
to_mm = 75.0
[world]
scene = "planes"
height = 40
width = 60
[world.effects.vignetting]
[world.effects.optics_psf]
sigma_px = 1e-6
"""


@pytest.fixture
def bench(tmp_path):
    file = tmp_path / "bench.toml"
    file.write_text(BENCH, encoding="utf-8")
    return file


def test_the_file_that_a_capture_reads_is_planned_as_the_capture_simulates_it(bench):
    planned = plan_of(bench)
    rig = load_rig(bench)
    devices = rig.open()
    try:
        record(rig, devices, prepare(rig, devices), bench.with_name("shot.h5"), replace=False, progress=Silent())
    finally:
        devices.close()
    (simulated,) = rig.bench.light.plans.values()
    assert [effect.name for effect in planned.effects] == [effect.name for effect in simulated.effects]
    bounds = {one.name: one.bound.rms_dn for one in simulated.decisions}
    for decision in planned.decisions:  # devices round, start late and expose a trigger's jitter later
        assert decision.bound.rms_dn == pytest.approx(bounds[decision.name], rel=0.1, abs=1e-6)
    assert "vignetting" in {effect.name for effect in planned.effects}
    assert "optics_psf" not in {effect.name for effect in planned.effects}


def test_a_coarser_tolerance_goes_before_a_benchs_too(bench):
    assert len(plan_of(bench, 100.0).effects) < len(plan_of(bench).effects)


def test_a_bench_of_real_devices_is_answered_with_the_command_that_plans_it(bench):
    real = BENCH.replace('"scpi"', '"scpi"\nport = "/dev/ttyS9"').replace('"v4l2"', '"v4l2"\nport = "/dev/video9"')
    bench.write_text(real.replace('"zaber"', '"zaber"\nport = "/dev/ttyS8"'), encoding="utf-8")
    with pytest.raises(InputError, match=r"are real.*gs2ci capture --dry-run"):
        plan.run(bench)


@pytest.mark.parametrize("tolerance_dn", [0.0, -1.0, float("nan"), float("inf")])
def test_a_tolerance_that_is_none_is_refused_by_its_option(rig, tolerance_dn):
    with pytest.raises(InputError, match="--tolerance-dn"):
        plan.run(rig, tolerance_dn=tolerance_dn)


def test_with_rays_the_rasteriser_counts(rig):
    assert "drawn by rays" in plan_of(rig, rays=True).summary()
    assert "drawn by rays" not in plan_of(rig).summary()
    assert "drawn by rays" not in plan_of(rig, 5000.0, rays=True).summary()


def test_rays_are_not_for_a_bench():
    bench = Path(__file__).parents[2] / "docs" / "rigs" / "simulated.toml"
    with pytest.raises(InputError, match="--rays for the bench"):
        plan_of(bench, rays=True)


def test_an_effect_is_explained_with_the_rigs_numbers_and_the_decision(rig, capsys):
    plan.run(rig, explain=("vignetting",))
    printed = capsys.readouterr().out
    assert "Bound: The share of its reading that each pixel loses" in printed
    assert "S = N_ph * q * K * g" in printed
    assert "simulated: exceeds its share" in printed
    assert "half of the tolerance of 0.25 DN" in printed
    assert "optics_psf" not in printed


def test_every_effect_is_explained_to_a_program_with_the_bounds_of_the_plan(rig, capsys):
    plan.run(rig, explain=("all",), json=True)
    answer = json.loads(capsys.readouterr().out)
    decided = plan_of(rig)
    assert [one["effect"] for one in answer["explanations"]] == [one.name for one in decided.decisions]
    for one, decision in zip(answer["explanations"], decided.decisions, strict=True):
        assert one["steps"][-1]["value"] == pytest.approx(decision.bound.rms_dn)
        assert one["verdict"].startswith("simulated" if decision.simulated else "left out")


def test_an_effect_that_the_rig_lacks_cannot_be_explained(rig):
    with pytest.raises(InputError, match=r"no effect 'defocus' on this rig.*\[effects.defocus\]"):
        plan.run(rig, explain=("defocus",))
    with pytest.raises(InputError, match="no effect 'glow'"):
        plan.run(rig, explain=("glow",))


def test_a_sweep_says_where_each_effect_begins_to_matter_and_draws_it(rig, tmp_path, capsys):
    picture = tmp_path / "regimes.png"
    plan.run(rig, sweep=("travel=0.001..1,effects.optics_psf.sigma_px=1e-6..1",), points=3, picture=picture, json=True)
    answer = json.loads(capsys.readouterr().out)
    travel, blur = answer["sweeps"]
    assert (travel["key"], travel["own"], travel["values"][0]) == ("path.parallax_px", 1.0, 0.001)
    assert travel["effects"]["vignetting"]["matters"] == [[None, None]]
    ((begins, ends),) = blur["effects"]["optics_psf"]["matters"]
    assert 1e-6 < begins < 1.0
    assert ends is None
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_sweep_is_printed_with_the_files_own_values(rig, capsys):
    plan.run(rig, sweep=("modulator.masks=1..4", "travel"), points=3)
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line.strip()}
    assert "all" in lines["vignetting"]
    assert "1 to 4" in lines["(swept)"]
    assert "0.1 to 10" in lines["(swept)"]  # a tenth to ten times the file's value
    assert plan_of(rig).tolerance_dn == 0.25


def test_a_sweep_with_rays_is_of_plans_with_rays(rig, bench, capsys):
    rig.write_text(RIG.replace("sigma_px = 1e-6", "sigma_px = 0.5"), encoding="utf-8")
    plan.run(rig, sweep=("travel=1..2",), points=2, rays=True, json=True)
    (travel,) = json.loads(capsys.readouterr().out)["sweeps"]
    by_rays, rasterised = (
        next(one.bound.rms_dn for one in plan_of(rig, rays=rays).decisions if one.name == "optics_psf")
        for rays in (True, False)
    )
    assert travel["effects"]["optics_psf"]["bounds_dn"][0] == pytest.approx(by_rays, rel=1e-9)
    assert by_rays != pytest.approx(rasterised, rel=1e-3)
    with pytest.raises(InputError, match="--rays for the bench"):
        plan.run(bench, sweep=("travel=0.5..2",), points=2, rays=True)


def test_a_bench_is_swept_by_its_own_keys(bench, capsys):
    plan.run(bench, sweep=("travel=0.5..2",), points=2, json=True)
    (travel,) = json.loads(capsys.readouterr().out)["sweeps"]
    assert (travel["own"], travel["unit"]) == (1.0, "mm")
    blur = travel["effects"]["motion_blur"]["bounds_dn"]
    assert blur[1] > 1.5 * blur[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sweep": ("mask_s=1",)}, "range '1'"),
        ({"sweep": ("mask_s=2..1",)}, "from 2 to 1"),
        ({"sweep": ("mask_s=1..inf",)}, "finite numbers"),
        ({"sweep": ("aperture",)}, "'aperture' without a range"),
        ({"sweep": ("plan.off=1..2",)}, "plan.off, which is"),
        ({"sweep": ("light.glow=1..2",)}, "glow"),
        ({"sweep": ("aperture=0.1..1",)}, "focus_depth"),
        ({"sweep": ("mask_s=1..2",), "points": 1}, "--points 1"),
        ({"sweep": ("mask_s=5ms..20ms",)}, "range '5ms..20ms'"),
        ({"sweep": ("trvel=1..2",)}, "a sweep of 'trvel'"),
        ({"sweep": ("scene.name.x=1..2",)}, "within scene.name, which is"),
        ({"picture": Path("x.png")}, "--picture without --sweep"),
        ({"sweep": ("mask_s=1..2",), "explain": ("all",)}, "--explain with --sweep"),
    ],
)
def test_a_sweep_that_cannot_be_is_refused(rig, options, words):
    rig.write_text(RIG.replace("height = 16", 'height = 16\nname = "planes"'), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        plan.run(rig, **options)


def test_what_the_rig_cannot_have_is_refused_before_any_plan_is_made(bench, monkeypatch):
    monkeypatch.setattr("gs2ci_sims.sweeping.swept", lambda *_, **__: pytest.fail("a plan is made"))
    with pytest.raises(InputError, match="'density' in"):
        plan.run(bench, sweep=("travel=0.5..2", "capture.density=0.1..2"), points=3)


def test_the_sweeps_of_the_page_are_of_numbers_that_the_rigs_have(monkeypatch):
    root = Path(__file__).parents[2]
    page = (root / "docs" / "commands" / "plan.md").read_text(encoding="utf-8")
    lines = re.findall(r"^    gs2ci plan (\S+) --sweep (.*?)(?: --.*)?$", page, re.MULTILINE)
    assert len(lines) == 2
    monkeypatch.setattr("gs2ci_sims.sweeping.swept", lambda *_, key, **__: key)
    keys = [sweep(root / rig, text.replace(",", " ").split()) for rig, text in lines]
    assert keys == [("path.parallax_px", "timing.interval_s"), (TRAVEL_KEY, "registration.superpixel")]
    assert sweep(root / "docs" / "rigs" / "simulated.toml", "mask_s=0.01..0.02") == ("capture.mask_s",)


def test_a_map_replaces_an_earlier_map_and_nothing_else(rig, tmp_path):
    kept, made = tmp_path / "measurement.npz", tmp_path / "map.png"
    kept.write_bytes(b"PK readings")
    with pytest.raises(StorageError, match="not a drawing of gs2ci"):
        plan.run(rig, sweep=("travel=0.1..1",), points=2, picture=kept)
    assert kept.read_bytes() == b"PK readings"
    for _ in range(2):
        plan.run(rig, sweep=("travel=0.1..1",), points=2, picture=made)
    assert made.read_bytes().startswith(b"\x89PNG")
