import json
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from gs2ci.evaluate import environment


def test_versions_name_the_packages_that_decide_the_figures():
    versions = environment.versions()
    assert versions["torch"] == metadata.version("torch")
    assert {"python", "gs2ci", "numba"} <= set(versions)


def test_a_package_that_is_not_installed_is_said_to_be_missing(monkeypatch):
    monkeypatch.setattr(environment, "REPORTED_PACKAGES", ("no-such-package-of-ours",))
    assert environment.versions()["no-such-package-of-ours"] == "not installed"


def test_the_machine_is_described_by_what_decides_the_seconds():
    machine = environment.machine()
    assert machine.processor
    assert machine.usable_cores >= 1
    assert machine.memory_mib > 100


def test_the_processor_is_named_where_there_is_no_cpuinfo(monkeypatch, tmp_path):
    monkeypatch.setattr(environment, "CPU_LISTING", tmp_path / "absent")
    assert environment.machine().processor


def test_peak_memory_is_read_in_the_systems_own_unit(monkeypatch, tmp_path):
    monkeypatch.setattr(environment, "PROCESS_STATUS", tmp_path / "absent")
    monkeypatch.setattr(environment.sys, "platform", "linux")
    on_linux = environment.peak_mib()
    monkeypatch.setattr(environment.sys, "platform", "darwin")
    assert on_linux > 10
    assert environment.peak_mib() < on_linux / 500


def test_both_sources_of_the_peak_agree(monkeypatch, tmp_path):
    np.ones(100 * 2**17).sum()  # above all that came before, so that neither is of another time
    told = environment.peak_mib()
    monkeypatch.setattr(environment, "PROCESS_STATUS", tmp_path / "absent")
    assert environment.peak_mib() >= 0.95 * told > 100


def peaks():
    """Print the peak before, with and after 200 MiB: in a process of its own, where nothing else comes and goes."""
    environment.restart_peak()
    held = environment.peak_mib()
    large = np.ones(200 * 2**17)
    told = environment.peak_mib()
    del large
    environment.restart_peak()
    print(json.dumps([held, told, environment.peak_mib()]))


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="only Linux restarts the peak")
def test_the_peak_of_one_run_is_not_that_of_the_run_before():
    code = "from tests.evaluate.test_environment import peaks; peaks()"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=Path(__file__).parents[2]
    )
    held, told, after = json.loads(done.stdout.splitlines()[-1])
    assert told > held + 190
    assert after < held + 50


def test_where_no_peak_can_be_restarted_it_is_that_of_the_process(monkeypatch, tmp_path):
    monkeypatch.setattr(environment, "PEAK_RESET", tmp_path / "absent" / "clear_refs")
    before = environment.peak_mib()
    environment.restart_peak()
    assert environment.peak_mib() >= before
