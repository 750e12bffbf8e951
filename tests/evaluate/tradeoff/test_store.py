"""Finished cells on disk, and what their names depend on."""

import pytest

from gs2ci.core.errors import StorageError
from gs2ci.evaluate.tradeoff import store as store_module
from gs2ci.evaluate.tradeoff.store import Store, content_key


def test_a_kept_row_comes_back(tmp_path):
    store = Store(tmp_path / "cells")
    store.put("key", {"psnr_db": 31.5, "nate": None})
    assert store.get("key") == {"psnr_db": 31.5, "nate": None}
    assert [path.name for path in (tmp_path / "cells").iterdir()] == ["key.json"]


def test_an_unknown_key_and_a_file_cut_short_count_as_undone(tmp_path):
    store = Store(tmp_path)
    (tmp_path / "short.json").write_text('{"psnr_db": 3')
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    assert store.get("unknown") is None
    assert store.get("short") is None
    assert store.get("list") is None
    assert store.get("deep") is None


def test_a_fresh_store_forgets_what_is_there(tmp_path):
    Store(tmp_path).put("key", {"value": 1})
    assert Store(tmp_path, fresh=True).get("key") is None


def test_a_folder_that_cannot_be_made_is_a_storage_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        Store(tmp_path / "file").put("key", {})


def test_the_key_depends_on_work_and_arguments():
    keys = {content_key("work", {"seed": 0}), content_key("other", {"seed": 0}), content_key("work", {"seed": 1})}
    assert len(keys) == 3
    assert content_key("work", {"a": 1, "b": 2}) == content_key("work", {"b": 2, "a": 1})


def test_the_key_depends_on_our_sources(monkeypatch, tmp_path):
    before = content_key("work", {})
    source = tmp_path / "changed.py"
    source.write_text("x = 1\n")
    monkeypatch.setattr(store_module, "_source_files", lambda: iter([source]))
    store_module._sources_digest.cache_clear()
    try:
        assert content_key("work", {}) != before
    finally:
        store_module._sources_digest.cache_clear()
