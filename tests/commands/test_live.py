"""`gs2ci live`: where it is, and that it leaves a bench at rest."""

import re

from gs2ci.commands import live
from gs2ci.rig.live import bench as live_bench
from tests.rig.live.conftest import MODULATOR, RIG


def test_it_says_where_the_bench_is_and_closes_it(tmp_path, monkeypatch, capsys):
    path = tmp_path / "rig.toml"
    left = {"world": "", "modulator": MODULATOR, "capture": "mask_s = 0.02", "light_e_per_s": 1e5}
    path.write_text(RIG.format(kind="v4l2", format="Y12", **left))
    closed = []
    close = live_bench.LiveBench.close

    def note(bench):
        close(bench)
        closed.append(bench.armed)

    monkeypatch.setattr(live_bench.LiveBench, "close", note)

    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr(live, "wait_for_the_end", interrupted)
    live.run(rig=path, port=0)
    assert re.search(r"the bench is at http://127\.0\.0\.1:\d+/\?secret=[\w-]+\n", capsys.readouterr().out)
    assert closed == [[]]
