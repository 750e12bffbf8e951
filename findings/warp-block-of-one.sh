#!/usr/bin/env bash
# Warp's `launch_tiled(dim=[2], block_dim=64)` runs a kernel with 64 threads for each of its 2 blocks on a GPU. A good guess: on
# the CPU, too. Found: on the CPU each block has one thread, `wp.block_dim()` is 1 and 2 of 128 numbers are written, without a
# word; `wp.config.enable_cpu_blocks = True`, False unless set, makes it 64 and writes all.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 warp-lang==1.19.0
cat >blocks.py <<'PY'
import sys
import warp as wp
wp.config.kernel_cache_dir = sys.argv[2]
wp.config.log_level = wp.LOG_WARNING
wp.config.enable_cpu_blocks = sys.argv[1] == "blocks"

@wp.kernel
def write_width(out: wp.array(dtype=int)):
    block, lane = wp.tid()
    out[block * 64 + lane] = wp.block_dim()

out = wp.zeros(128, dtype=int, device="cpu")
wp.launch_tiled(write_width, dim=[2], inputs=[out], block_dim=64, device="cpu")
values = out.numpy()
print(wp.__version__, sys.argv[1], int((values > 0).sum()), "written, width", int(values.max()))
PY
plain=$(v/bin/python blocks.py plain "$place/a" 2>/dev/null | tail -1); blocks=$(v/bin/python blocks.py blocks "$place/b" 2>/dev/null | tail -1)
echo "warp-lang $plain"; echo "warp-lang $blocks"
[ "$plain" = "1.19.0 plain 2 written, width 1" ] && [ "$blocks" = "1.19.0 blocks 128 written, width 64" ] || exit 1
