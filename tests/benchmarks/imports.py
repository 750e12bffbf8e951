"""What `gs2ci import` says of drawn measurements, right ones and spoiled ones.

    python -m tests.benchmarks imports
    GS2CI_DRAWS=50 python -m tests.benchmarks imports     fewer of them
    GS2CI_DRAWS=0 GS2CI_AGAINST=FOLDER python -m tests.benchmarks imports     the cost, paired with another checkout

500 right measurements (`import_forms.right`) and, where the shared data are, its real exposures: how many raise an
alarm. 500 spoiled ones, those of F1 to F4 of the report on people's files in turn, then 60 of each other way: how many
are named before anything is decoded, how many of those that are not named decode to less than 20 dB. The decode is
GAP-TV with the imported masks against the views that were shown, after the best factor of brightness, because the scale
of a file is another question.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gs2ci.core.foreign.assemble import Imported, import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from tests.benchmarks import import_forms as forms
from tests.processes import ONE_THREAD

ROOT = Path(__file__).parents[2]
_ROUNDS = 3
# Import and write each file a few times; the least counts, since other load only adds.
_COST = """
import json, pathlib, sys, tempfile, time
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.storage import write_shots
found = {}
for name in sys.argv[1:]:
    for k in range(5):
        with tempfile.TemporaryDirectory() as folder:
            start = time.process_time()
            shots = import_shots(pathlib.Path(name), None, ImportOptions()).shots
            write_shots(pathlib.Path(folder) / "shot.h5", shots)
            found[name] = min(found.get(name, 1e9), 1e3 * (time.process_time() - start))
print(json.dumps(found))
"""
DRAWS = int(os.environ.get("GS2CI_DRAWS", "500"))
MAIN = ("divided", "gamma", "srgb", "wrapped", "more")
# Said of right measurements as well, and right to say: not alarms about what was measured.
NO_ALARMS = ("count as clipped", "are exactly", "looks like a colour mosaic")


def run() -> None:
    """Print the figures."""
    if other := os.environ.get("GS2CI_AGAINST"):
        _print_cost(Path(other))
    if not DRAWS:
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.npz"
        false = [drawn.kinds for drawn in _right(DRAWS) if alarms(taken(path, drawn))]
        print(f"right: {DRAWS} drawn, {len(false)} false alarms {false}")
        real = sorted(Path(os.environ.get("GS2CI_SHARED_DATA", "../shared/data")).glob("*/*_cacti.mat"))
        told = {file.name: alarms(import_shots(file, None, ImportOptions())) for file in real}
        print(f"real and published exposures: {len(told)}, alarms", {name: all_ for name, all_ in told.items() if all_})
        _print_named(path, [MAIN[k % len(MAIN)] for k in range(DRAWS)])
        for how in forms.SPOILS:
            if how not in MAIN:
                _print_named(path, [how] * min(60, DRAWS))


def _print_cost(other: Path) -> None:
    """Import and write the shared measurements by both checkouts in turns, and print processor milliseconds."""
    files = [
        str(file) for file in sorted(Path(os.environ.get("GS2CI_SHARED_DATA", "../shared/data")).glob("**/*.[nm]*"))
    ]
    files = [file for file in files if file.endswith(("fern_smooth.npz", "cr16.npz", "_cacti.mat", "base.npz"))]
    found: dict[Path, list[dict[str, float]]] = {ROOT: [], other: []}
    for _ in range(_ROUNDS):
        for folder, times in found.items():
            done = subprocess.run(
                [sys.executable, "-P", "-c", _COST, *files],
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": str(folder)},
                cwd=folder,
                capture_output=True,
                text=True,
                check=True,
            )
            times.append(json.loads(done.stdout))
    for file in files:
        mine, theirs = (min(times[file] for times in found[folder]) for folder in (ROOT, other))
        print(f"{Path(file).name}: {mine:.0f} ms of processor time instead of {theirs:.0f} ({mine / theirs - 1:+.0%})")


def _right(count: int) -> Iterator[forms.Drawn]:
    for seed in range(count):
        yield forms.right(np.random.default_rng([seed, 3]))


def _print_named(path: Path, ways: list[str]) -> None:
    done: Counter[tuple[str, str]] = Counter()
    silent = []
    for seed, how in enumerate(ways):
        drawn = forms.spoiled(np.random.default_rng([seed, 4]), how)
        imported = taken(path, drawn)
        if alarms(imported):
            provenance = imported.shots[0].provenance
            undone = provenance["undone"] or ("masks" if len(imported.shots[0].masks) < len(drawn.masks) else "")
            done[how, undone or "named"] += 1
        else:
            done[how, "silent"] += 1
            silent.append((round(decoded_db(drawn, imported), 1), how, drawn.kinds))
    named = len(ways) - len(silent)
    print(f"spoiled ({', '.join(sorted(set(ways)))}): {named} of {len(ways)} named ({named / len(ways):.1%})")
    print("   ", {" ".join(key): count for key, count in sorted(done.items())})
    for figure in sorted(silent, key=lambda row: row[0]):
        print("    silent:", figure, flush=True)


def taken(path: Path, drawn: forms.Drawn) -> Imported:
    """Import what was drawn, with what an owner knows: the mosaic."""
    np.savez(path, meas=drawn.measurement, masks=drawn.masks)
    return import_shots(path, None, ImportOptions(scale=drawn.full, cfa=drawn.cfa))


def alarms(imported: Imported) -> list[str]:
    """Return the warnings that say something is wrong with the file."""
    warnings = [guess for guess in imported.guesses if guess.startswith("WARNING")]
    return [guess for guess in warnings if not any(words in guess for words in NO_ALARMS)]


def decoded_db(drawn: forms.Drawn, imported: Imported) -> float:
    """Decode, and return the PSNR against the views shown after the best factor."""
    views = gap_tv(imported.shots[0]).astype(np.float64)
    truth = np.asarray(drawn.views, np.float64)
    truth = truth if truth.ndim == 4 else truth[..., None]
    views = views[: len(truth)]
    factor = float((views * truth).sum() / max(float((views * views).sum()), 1e-12))
    return float(-10 * np.log10(np.mean((factor * views - truth) ** 2)))
