from pathlib import Path

import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.config import read_rig
from gs2ci.rig.opening import load_rig
from gs2ci_sims.rigs import library

RIGS = Path(__file__).parents[2] / "docs" / "rigs"
MINIMAL = '[modulator]\nkind = "dlpc900"\n[sensor]\nkind = "v4l2"\n'


def read(tmp_path, text):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return read_rig(path)


@pytest.mark.parametrize("path", sorted(RIGS.glob("*.toml")), ids=lambda path: path.name)
def test_the_rig_files_in_the_docs_are_valid_and_commented(path):
    rig, text = read_rig(path)
    assert rig.capture.axis in rig.stage.axes
    assert text.count("#") >= 8
    assert bool(rig.simulated) == (path.name == "simulated.toml")


def test_a_minimal_simulated_rig_is_enough(tmp_path):
    rig, _ = read(tmp_path, MINIMAL + "[world]\n")
    assert rig.simulated == ("modulator", "sensor")
    assert rig.stage is None


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (MINIMAL, r"simulated devices without a \[world\]"),
        (MINIMAL.replace('"v4l2"\n', '"v4l2"\nport = "/dev/video0"\n') + "[world]\n", "only modulator of 2 devices"),
        (MINIMAL + '[stage]\nkind = "zaber"\naxes = {x = 1, y = 2}\n[world]\n', "name the same axes"),
        (
            MINIMAL.replace('"dlpc900"', '"video"\ndark_level = 9\nbright_level = 9') + "[world]\n",
            r"rig\.toml: \[modulator\]: dark_level and bright_level must be two different levels, 0 to 255$",
        ),
        (MINIMAL, r"rig\.toml: simulated devices without"),
        (MINIMAL + "[world]\n[capture]\nmaskes = 3\n", r"'maskes' in \[capture\]; did you mean 'masks'"),
        (MINIMAL + "[world]\n[stage.mont]\n", r"'kind' is missing in \[stage\]"),
        (MINIMAL + '[world]\n[capture]\nmode = "gated"\n', "'mode' in .capture. is 'gated'"),
        (MINIMAL + "[world]\n[capture]\nmask_s = inf\n", "mask_s"),
        (MINIMAL + "[world]\n[capture]\nfrom_mm = nan\n", "'from_mm' in .capture. is nan"),
        (MINIMAL + "[world]\n[capture]\nmask_s = 1e5\n", "'mask_s' in .capture. is 100000.0.*equal to 86400"),
        (MINIMAL + "[world]\n[capture]\ndark_s = 1e15\n", "'dark_s' in .capture. is 1000000000000000.0"),
        (MINIMAL + "[world]\n[capture]\nshots = 1_000_000_000_000\n", "'shots' in .capture. is 1000000000000"),
        (MINIMAL + '[world]\n[stage]\nkind = "zaber"\nmount = {x = [inf, 0.0, 0.0]}\n', "finite"),
        (
            MINIMAL + '[world]\n[stage]\nkind = "zaber"\nmount = {x = [0, 0, 0]}\n',
            "'x' in .stage.mount.*its length is 0, ",
        ),
        (
            MINIMAL + "[world.mount]\ny = [0, 0.001, 0]\n",
            "'y' in .world.mount.*length is 0.001.*from 0.5 to 2, such",
        ),
        (f"a = {'[' * 100_000}", "nests too deep"),
        ('name = "be\\u0000nch"\n' + MINIMAL + "[world]\n", "'name' has a NUL character"),
        (MINIMAL.replace('"v4l2"\n', '"v4l2"\nport = "/dev/\\u0000"\n'), "'sensor.port' has a NUL character"),
        (MINIMAL + '[world]\nfaults = ["\\u0000"]\n', "'world.faults.0' has a NUL character"),
    ],
)
def test_a_rig_that_cannot_be_is_refused_with_a_sentence(tmp_path, text, complaint):
    with pytest.raises(InputError, match=complaint):
        read(tmp_path, text)


@pytest.mark.parametrize("path", library(), ids=lambda path: path.name)
def test_the_rig_file_of_a_simulation_is_answered_with_the_command_that_takes_it(path):
    with pytest.raises(InputError, match=r"describes a simulation, not a bench") as caught:
        read_rig(path)
    assert f"gs2ci plan {path}" in caught.value.remedy


def test_a_table_of_a_simulation_in_a_benchs_file_is_an_unknown_key(tmp_path):
    with pytest.raises(InputError, match="unknown key 'light'"):
        read(tmp_path, MINIMAL + "[world]\n[light]\n")


def test_a_fault_that_names_no_device_is_refused(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(MINIMAL + '[world]\nscene = "planes"\nheight = 8\nwidth = 8\nfaults = ["lamp: out"]\n')
    with pytest.raises(InputError, match="modulator, sensor, stage"):
        load_rig(path)
