"""A simulated bench with a small picture, for tests and benchmarks of designs."""

from typing import Any, Final

from gs2ci.rig.config import rig_from_tables
from gs2ci.rig.design.exposing import SmallBench, small_bench

TABLES: Final[dict[str, dict[str, Any]]] = {
    "modulator": {"kind": "dlpc900", "port": "simulated", "trigger_out_2_bit": "disables"},
    "sensor": {
        "kind": "v4l2", "port": "simulated", "height": 36, "width": 48, "format": "Y12", "black_level_dn": 64.0,
        "trigger_adapter": "control",
    },
    "stage": {"kind": "zaber", "port": "simulated", "mount": {}},
    "capture": {"masks": 4, "mask_s": 0.02, "axis": "x", "from_mm": 74.0, "to_mm": 76.0},
    "world": {"scene": "planes", "height": 36, "width": 48},
}  # fmt: skip
SIZE: Final = (36, 48)


def bench_of(tmp_path, scene="boxes", size=SIZE, **changed) -> SmallBench:
    """Put the bench, with some of its tables changed, before a scene."""
    tables = {
        key: {**TABLES.get(key, {}), **table} for key, table in {**TABLES, **changed}.items() if table is not None
    }
    return small_bench(rig_from_tables(tables, tmp_path / "rig.toml"), scene, size)
