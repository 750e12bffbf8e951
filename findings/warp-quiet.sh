#!/usr/bin/env bash
# Examples of Warp set `wp.config.quiet = True` before `wp.init()`. A good guess: it still silences the banner, or is refused
# where it has gone. Found: Warp 1.19 has no such setting, takes it without a word and prints the banner; what silences it is
# `wp.config.log_level = wp.LOG_WARNING`.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 warp-lang==1.19.0
lines() { v/bin/python -c "import warp as wp; $1; wp.init()" 2>&1 | grep -c "Warp .* initialized" || true; }
quiet=$(lines "wp.config.quiet = True"); level=$(lines "wp.config.log_level = wp.LOG_WARNING")
echo "warp-lang 1.19.0: banners with quiet = True: $quiet, with log_level = LOG_WARNING: $level"
[ "$quiet" = 1 ] && [ "$level" = 0 ] || exit 1
