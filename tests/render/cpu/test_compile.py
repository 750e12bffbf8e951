from pathlib import Path

from numba import config

from gs2ci.render.backend import needs_compiling
from gs2ci.render.cpu import compile as compiling
from gs2ci.render.cpu.project import project


def test_kernels_are_cached_under_a_digest_of_all_their_sources(monkeypatch, tmp_path):
    kept = ["cpu/a.py", "cpu/b.py", "simd/c.py", "conventions.py", "gaussians.py", "screen.py", "stopping.py"]
    for name in [*kept, "ply.py"]:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    monkeypatch.setattr(compiling, "__file__", str(tmp_path / "cpu" / "a.py"))
    digests = [compiling.sources_digest()]
    for name in kept:
        (tmp_path / name).write_text("changed")
        digests.append(compiling.sources_digest())
    assert len(set(digests)) == 1 + len(kept)
    (tmp_path / "ply.py").write_text("changed")
    assert compiling.sources_digest() == digests[-1]


def test_kernels_of_this_checkout_use_that_folder():
    assert f"kernels-{compiling.sources_digest()}" in Path(project.stats.cache_path).parts


def test_decorating_leaves_the_users_cache_setting_alone():
    before = config.CACHE_DIR

    @compiling.kernel()
    def twice(x):
        return 2 * x

    assert before == config.CACHE_DIR
    assert twice(3) == 6


def test_users_cache_setting_is_preferred_to_the_packages_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "mine"))
    assert Path(compiling._cache_folder()).parent == tmp_path / "mine"


def test_package_that_cannot_be_written_leaves_its_kernels_in_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setattr(compiling.os, "access", lambda path, mode: Path(path).is_relative_to(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert Path(compiling._cache_folder()).parent == tmp_path / "gs2ci"


def test_kernels_still_run_where_nothing_can_be_written(monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setattr(compiling.os, "access", lambda path, mode: False)
    assert compiling._cache_folder() is None
    monkeypatch.setattr(compiling, "_CACHE_FOLDER", None)

    @compiling.kernel()
    def thrice(x):
        return 3 * x

    assert thrice(2) == 6


def test_a_backend_needs_compiling_until_its_kernels_lie_on_disk(monkeypatch, tmp_path):
    monkeypatch.setattr(compiling, "_CACHE_FOLDER", str(tmp_path))
    assert needs_compiling("cpu")
    (tmp_path / "cpu_0").mkdir()
    (tmp_path / "cpu_0" / "kernel.1.nbc").touch()
    assert not needs_compiling("cpu")
    monkeypatch.setattr(compiling, "_CACHE_FOLDER", None)
    assert needs_compiling("cpu")
    assert not needs_compiling("reference")
