"""Whether registration leaves correctly stated shots unchanged, and whether its standard errors match its errors.

    python -m tests.benchmarks right_shots                 100 shots, about two minutes of one core
    GS2CI_DRAWS=20 python -m tests.benchmarks right_shots  the first 20 of them
    GS2CI_FIRST=100 python -m tests.benchmarks right_shots  others: from number 100 on
    GS2CI_EACH=1 python -m tests.benchmarks right_shots    with what each shot was estimated at, value/standard error
    GS2CI_FORMS=1 python -m tests.benchmarks right_shots   undamaged ones of random form, however small, instead

Only the registration step runs. Every shot is drawn at random, and believed as it was taken: scenes of the simulator,
walls that give little to hold on to, photographs of scikit-image on two planes, and smooth scenes; 4 to 64 views,
binary, grey and laboratory masks, elements of 1 to 4 px, mosaics, dark shots, noise. What a right shot's parameters are
estimated at is an error, and z is that error in its own standard errors: with standard errors that are right, |z| is
above 2 in 5 % of the draws.
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.ndimage import shift as moved
from skimage.data import astronaut, chelsea, coffee

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.registration.register import Registered, register
from gs2ci_sims.effects.bayer_filter import BayerFilter
from tests.stability.benches import WALLS, Bench, aside
from tests.stability.laboratory import laboratory_masks
from tests.stability.random_forms import Form

DRAWS = 100
SIZES = ((64, 80), (96, 128), (144, 192))
# 64 views of the largest size would be most of the time.
MOST_VIEW_PIXELS = 600_000
SIMULATED = ("planes", "thicket", "ball", "boxes", "corridor", "motorcycle")
SMOOTH = ("soft gradient", "chequerboard", "stripes", "spots", "grey wall")
PHOTOGRAPHS: dict[str, Callable[[], np.ndarray]] = {"astronaut": astronaut, "coffee": coffee, "chelsea": chelsea}
KINDS = ("binary", "binary", "grey", "laboratory")
WORST = 12


@dataclass(frozen=True)
class Drawn:
    """A right shot and what it is."""

    told: str
    shot: Shot


def drawn(number: int) -> Drawn:
    """Draw the right shot of this number."""
    rng = np.random.default_rng([17, number])
    views = int(rng.choice([4, 6, 8, 8, 12, 16, 24, 32, 64]))
    sizes = [size for size in SIZES if views * size[0] * size[1] <= MOST_VIEW_PIXELS]
    size = sizes[rng.integers(len(sizes))]
    kind = KINDS[rng.integers(len(KINDS))]
    open_share = float(rng.uniform(0.15, 0.6))
    feature_px = int(rng.choice([1, 1, 1, 2, 4]))
    mosaic, dark = bool(rng.random() < 0.2), bool(rng.random() < 0.2)
    source = ("simulated", "simulated", "wall", "photograph", "photograph", "smooth")[rng.integers(6)]
    common = f"{views} views of {size[0]} x {size[1]}, {kind} masks of {feature_px} px, {open_share:.2f} open"
    common += (", mosaic" if mosaic else "") + (", dark" if dark else "")
    if source in ("simulated", "wall"):
        names = SIMULATED if source == "simulated" else SMOOTH
        bench = Bench(
            scene=names[rng.integers(len(names))],
            views=views,
            open_share=open_share,
            kind=kind,
            feature_px=feature_px,
            parallax_px=float(rng.uniform(0, 8)),
            effects=(BayerFilter(),) if mosaic else (),
        )
        if bench.scene in WALLS:
            bench = replace(bench, path=aside(0.05))
        if dark:  # a twentieth of the photons, in the unit of the full exposure
            bench = replace(bench, photons=0.05 * 0.4 * bench.sensor.full_well_e / max(1.0, views * open_share))
        return Drawn(f"{bench.scene}: {common}", bench.expose(size, int(rng.integers(1_000_000))))
    scene = _moving(_picture(source, size, views, rng), size, views, rng)
    noise = float(rng.choice([0.002, 0.01, 0.03]))
    return Drawn(
        f"{source}: {common}, noise {noise:g}", _coded(scene, kind, open_share, feature_px, noise, mosaic, dark, rng)
    )


def of_random_form(number: int) -> Drawn | None:
    """Draw the undamaged measurement of random form of this number; None where its lens would be refused."""
    form = replace(Form.draw(number), damage="none")
    try:
        return Drawn(str(form), form.shot())
    except InputError:
        return None


def _picture(source: str, size: tuple[int, int], views: int, rng: np.random.Generator) -> np.ndarray:
    """Draw a picture that reaches beyond a view on all sides, [H, W, 3] in [0, 1]."""
    height, width = size[0] + 24, size[1] + 64
    if source == "smooth":
        rough = gaussian_filter(rng.normal(size=(height, width, 3)), (rng.uniform(4, 16),) * 2 + (0,))
        return np.clip(0.5 + 0.2 * rough / rough.std(), 0, 1)
    names = list(PHOTOGRAPHS)
    picture = PHOTOGRAPHS[names[rng.integers(len(names))]]()[:, :, :3].astype(float) / 255
    step = max(1, min(picture.shape[0] // height, picture.shape[1] // width))
    return gaussian_filter(picture, (0.4 * step, 0.4 * step, 0))[::step, ::step][:height, :width]


def _moving(picture: np.ndarray, size: tuple[int, int], views: int, rng: np.random.Generator) -> np.ndarray:
    """Move a picture behind a disc of itself, by up to 8 px in all, [N, H, W, 3]."""
    pace = rng.uniform(0, 8) / views
    rows, columns = np.ogrid[: size[0], : size[1]]
    disc = (np.hypot(rows - 0.6 * size[0], columns - 0.45 * size[1]) < 0.25 * size[0])[..., None]

    def layer(picture: np.ndarray, far: float) -> np.ndarray:
        shifted = moved(picture, (0.1 * far, far, 0), order=1, mode="reflect")
        return shifted[8 : size[0] + 8, 16 : size[1] + 16]

    seen = []
    for k in range(views):
        far, near = layer(picture, 0.3 * pace * k), layer(picture[::-1], pace * k)
        seen.append(np.where(np.roll(disc, round(pace * k), axis=1), near, far))
    return np.clip(np.stack(seen), 0, 1)


def _coded(
    views: np.ndarray,
    kind: str,
    open_share: float,
    feature_px: int,
    noise: float,
    mosaic: bool,
    dark: bool,
    rng: np.random.Generator,
) -> Shot:
    """Code views by numpy alone; noise is a share of the brightest reading before the light was dimmed."""
    count, height, width = views.shape[:3]
    if kind == "laboratory":
        masks = laboratory_masks(count, (height, width), open_share, rng)
    else:
        coarse = rng.random((count, -(-height // feature_px), -(-width // feature_px)))
        coarse = coarse if kind == "grey" else (coarse < open_share).astype(float)
        masks = coarse.repeat(feature_px, axis=1).repeat(feature_px, axis=2)[:, :height, :width]
    light = np.einsum("nhw,nhwc->hwc", masks, views)
    light = (0.1 if dark else 1.0) * light + rng.normal(0, noise * light.max() * (0.1 if dark else 1), light.shape)
    if mosaic:
        channels = np.array([[0, 1], [1, 2]])[np.indices((height, width))[0] % 2, np.indices((height, width))[1] % 2]
        light = np.take_along_axis(light, channels[..., None], axis=2)
    return Shot(
        light.astype(np.float32),
        masks.astype(np.float32),
        np.ones(count, np.float32),
        cfa="RGGB" if mosaic else None,
    ).check()


def errors_of(found: Registered) -> dict[str, tuple[float, float]]:
    """Return what each parameter was estimated at, and its standard error, whether it was let in or not."""
    taken = found.misfit.values()
    return {**found.tried, **{name: (taken[name], error) for name, error in found.errors.items()}}


def run() -> None:
    """Print what was corrected, and how errors compare with their standard errors."""
    count, first = int(os.environ.get("GS2CI_DRAWS", DRAWS)), int(os.environ.get("GS2CI_FIRST", "0"))
    scored: dict[str, list[tuple[float, float, str]]] = {}
    draw = of_random_form if os.environ.get("GS2CI_FORMS") else drawn
    corrected, silent, began = 0, 0, time.process_time()
    seconds = 0.0
    for number in range(first, first + count):
        one = draw(number)
        if one is None:
            count -= 1
            continue
        started = time.process_time()
        found = register(one.shot)
        seconds += time.process_time() - started
        corrected += found.is_changed
        for note in found.notes:
            print(f"  corrected: draw {number}, {one.told}: {note.sentence}", flush=True)
        told = errors_of(found)
        silent += not told
        if os.environ.get("GS2CI_EACH"):
            each = " ".join(f"{name} {value:+.2g}/{error:.2g}" for name, (value, error) in told.items())
            print(f"{number}, {one.told}: peak {found.peak.ratio:.1f}: {each}", flush=True)
        for name, (value, error) in told.items():
            scored.setdefault(name, []).append((value / error if error > 0 else 0.0, value, f"{number}, {one.told}"))
    print(f"of {count} right shots {corrected} were corrected; {silent} showed nothing of where their masks are")
    print("parameter        draws  |z| > 2   > 3   largest |z|   rms z  median |error|")
    for name, rows in scored.items():
        z, values = (np.abs([row[k] for row in rows]) for k in (0, 1))
        print(
            f"{name:15s} {len(z):6d}  {100 * np.mean(z > 2):6.1f} % {100 * np.mean(z > 3):5.1f} %  {z.max():9.2f}"
            f"  {np.sqrt(np.mean(z**2)):8.2f}  {np.median(values):.2g}"
        )
    worst = sorted(
        ((abs(z), name, value, told) for name, rows in scored.items() for z, value, told in rows), reverse=True
    )
    for z, name, value, told in worst[:WORST]:
        print(f"  {name} {value:+.3g}, {z:.1f} of its standard errors: draw {told}")
    total = time.process_time() - began
    print(f"CPU: {seconds / count:.2f} s a registration, {total:.0f} s in all")
