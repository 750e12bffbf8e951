from importlib import metadata

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
    assert machine["processor"]
    assert machine["usable_cores"] >= 1
    assert machine["memory_mib"] > 100


def test_the_processor_is_named_where_there_is_no_cpuinfo(monkeypatch, tmp_path):
    monkeypatch.setattr(environment, "CPU_LISTING", tmp_path / "absent")
    assert environment.machine()["processor"]


def test_peak_memory_is_read_in_the_systems_own_unit(monkeypatch):
    monkeypatch.setattr(environment.sys, "platform", "linux")
    on_linux = environment.peak_mib()
    monkeypatch.setattr(environment.sys, "platform", "darwin")
    assert on_linux > 10
    assert environment.peak_mib() < on_linux / 500
