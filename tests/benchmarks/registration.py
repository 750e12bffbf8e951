"""What registration recovers if masks, light or readings differ from their stated values.

    python -m tests.benchmarks registration                decodes alone: a quarter of an hour
    GS2CI_WHOLE=1 python -m tests.benchmarks registration  whole reconstructions of fewer scenes: hours

`GS2CI_SEEDS=1` takes one seed instead of three, `GS2CI_CASES=blur` only cases whose names contain that word.

Every case is a shot whose truth is known, stated wrongly in one way. Its decode is scored three times: with true
masks and readings, as stated, and as registered. Scenes: photographs of scikit-image on two planes that move against
each other, coded here by numpy with masks drawn on a larger modulator and warped by scipy (nothing of the solver's own,
and what a shift brings into the picture is not known); and scenes of the simulator, whose light path has none
of it either. Three seeds each. Right shots of all kinds: `right_shots`.
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import affine_transform, gaussian_filter
from scipy.ndimage import shift as moved
from skimage.data import astronaut, chelsea, coffee

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.registration.register import Registered, register
from gs2ci.reconstruct.settings import Settings
from tests.reconstruct.registration.warps import bent, regrown
from tests.stability.benches import Bench

VIEWS = 8
SIZE = (176, 208)
MARGIN = 24
SEEDS = (0, 1, 2)
PHOTOGRAPHS: dict[str, Callable[[], np.ndarray]] = {"astronaut": astronaut, "coffee": coffee, "chelsea": chelsea}
SIMULATED = ("planes", "thicket", "boxes")

Masks = np.ndarray
Pair = tuple[Shot, Shot]


@dataclass(frozen=True)
class Scene:
    """A scene that can be exposed through any masks.

    Args:
        name: For the table.
        expose: Takes masks, [N, H, W], relative noise and a seed.
    """

    name: str
    expose: Callable[[Masks, float, int], Shot]


def photograph(name: str) -> Scene:
    """Move a photograph behind a disc of itself."""
    picture = PHOTOGRAPHS[name]()[:, :, :3].astype(float) / 255
    step = min(picture.shape[0] // (SIZE[0] + 16), picture.shape[1] // (SIZE[1] + 16))
    picture = gaussian_filter(picture, (0.4 * step, 0.4 * step, 0))[::step, ::step]
    rows, columns = np.ogrid[: SIZE[0], : SIZE[1]]
    disc = (np.hypot(rows - 0.6 * SIZE[0], columns - 0.45 * SIZE[1]) < 0.25 * SIZE[0])[..., None]

    def view(k: int) -> np.ndarray:
        far, near = (
            moved(picture, (0.1 * pace * k, pace * k, 0), order=1, mode="reflect")[8 : SIZE[0] + 8, 8 : SIZE[1] + 8]
            for pace in (0.3, 0.9)
        )
        return np.where(np.roll(disc, round(0.9 * k), axis=1), near[::-1], far)

    views = np.clip(np.stack([view(k) for k in range(VIEWS)]), 0, 1).astype(np.float32)

    def expose(masks: Masks, noise: float, seed: int) -> Shot:
        light = np.einsum("nhw,nhwc->hwc", masks, views)
        light = light + np.random.default_rng([seed, 1]).normal(0, noise * light.max(), light.shape)
        weights = np.ones(len(masks), np.float32)
        return Shot(light.astype(np.float32), masks.astype(np.float32), weights, truth=Truth(views)).check()

    return Scene(name, expose)


def simulated(name: str) -> Scene:
    """Expose a scene of the simulator, with its noise and its motion within a mask."""

    def expose(masks: Masks, noise: float, seed: int) -> Shot:
        class Told(Bench):
            def _masks(self, size: tuple[int, int], seed: int) -> Masks:
                return masks.astype(np.float32)

        shot = Told(name).expose(SIZE, seed)
        added = np.random.default_rng([seed, 1]).normal(0, noise * shot.measurement.max(), shot.measurement.shape)
        return replace(shot, measurement=(shot.measurement + added).astype(np.float32))

    return Scene(f"{name} (simulator)", expose)


def drawn(seed: int) -> Masks:
    """Draw masks on a modulator that reaches beyond the picture, [N, H + 2 margin, W + 2 margin]."""
    size = (SIZE[0] + 2 * MARGIN, SIZE[1] + 2 * MARGIN)
    return (np.random.default_rng([seed, 2]).random((VIEWS, *size)) < 0.25).astype(float)


def inside(masks: Masks) -> Masks:
    """Return the part that the sensor sees."""
    return masks[:, MARGIN:-MARGIN, MARGIN:-MARGIN]


def warped(masks: Masks, down: float = 0, right: float = 0, turn_deg: float = 0, scale: float = 1) -> Masks:
    """Move masks about their middle: elements and pixels of one pitch overlap bilinearly."""
    turn = np.deg2rad(turn_deg)
    back = np.linalg.inv(scale * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))
    middle = (np.array(masks.shape[1:]) - 1) / 2
    offset = middle - back @ (middle + np.array([down, right]))
    return np.stack([affine_transform(mask, back, offset, order=1, mode="nearest") for mask in masks])


def bowed(masks: Masks, corner_px: float) -> Masks:
    """Bend masks as a lens does, so that the corners of the picture inside go outwards by so much."""
    inner, whole = (np.hypot(size[0] - 1, size[1] - 1) for size in (SIZE, masks.shape[1:]))
    return bent(masks, radial_px=corner_px * float(whole / inner) ** 3)[0]


def blurred(masks: Masks, sigma: float) -> Masks:
    """Blur masks."""
    return gaussian_filter(masks, (0, sigma, sigma))


def were(change: Callable[[Masks], Masks], noise: float = 0.004) -> Callable[[Scene, int], Pair]:
    """Expose through changed masks, and state those that were drawn."""

    def pair(scene: Scene, seed: int) -> Pair:
        masks = drawn(seed)
        told = scene.expose(inside(np.clip(change(masks), 0, 1)), noise, seed)
        return told, replace(told, masks=inside(masks).astype(np.float32))

    return pair


def both(real: Callable[[Masks], Masks], change: Callable[[Masks], Masks]) -> Callable[[Scene, int], Pair]:
    """Expose through the first masks made of those that were drawn, and state the second ones made of these."""

    def pair(scene: Scene, seed: int) -> Pair:
        masks = real(inside(drawn(seed)))
        told = scene.expose(masks, 0.004, seed)
        return told, replace(told, masks=np.ascontiguousarray(np.clip(change(masks), 0, 1), np.float32))

    return pair


def stated(change: Callable[[Masks], Masks]) -> Callable[[Scene, int], Pair]:
    """Expose through the masks that were drawn, and state changed ones."""
    return both(lambda masks: masks, change)


def read(change: Callable[[F32], F32]) -> Callable[[Scene, int], Pair]:
    """Change the readings."""

    def pair(scene: Scene, seed: int) -> Pair:
        told = scene.expose(inside(drawn(seed)), 0.004, seed)
        return told, replace(told, measurement=change(told.measurement).astype(np.float32))

    return pair


def clipped(scene: Scene, seed: int) -> Pair:
    """Clip half of the pixels; told: say which."""
    shot = scene.expose(inside(drawn(seed)), 0.004, seed)
    level = np.float32(np.quantile(shot.measurement.max(axis=2), 0.5))
    low = replace(shot, measurement=np.minimum(shot.measurement, level), saturated=None)
    return replace(low, saturated=(shot.measurement >= level).any(axis=2)), low


def calibrated(masks: Masks, sigma: float) -> Masks:
    """Add the noise of a calibration."""
    return masks + np.random.default_rng(6).normal(0, sigma, masks.shape)


def everything(masks: Masks) -> Masks:
    """Shift by 0.7 px, turn by 0.2°, blur by 0.7 px, leak 3 %."""
    return 0.97 * blurred(warped(masks, 0.5, -0.5, 0.2), 0.7) + 0.03


CASES: dict[str, Callable[[Scene, int], Pair]] = {
    "nothing": were(lambda m: m),
    **{
        f"shift {p:g} px": were(lambda m, p=p: warped(m, 0.6 * p, -0.8 * p))  # type: ignore[misc]
        for p in (0.25, 0.5, 1, 2, 4, 16)
    },
    **{
        f"stated shifted {p:g} px": stated(lambda m, p=p: moved(m, (0, 0, p), order=1, mode="nearest"))
        for p in (0.25, 0.5)
    },  # type: ignore[misc]
    **{
        f"stated magnified {f:g}": stated(lambda m, f=f: warped(m, scale=f))  # type: ignore[misc]
        for f in (0.98, 1.02)
    },
    "rotation 0.3°": were(lambda m: warped(m, turn_deg=0.3)),
    "rotation 3°": were(lambda m: warped(m, turn_deg=3)),
    "scale 1.005": were(lambda m: warped(m, scale=1.005)),
    "scale 0.97": were(lambda m: warped(m, scale=0.97)),
    "bent 1.5 px in the corners": were(lambda m: bowed(m, 1.5)),
    "bent 3 px in the corners": were(lambda m: bowed(m, 3.0)),
    **{f"blur σ {s:g} px": were(lambda m, s=s: blurred(m, s)) for s in (0.5, 1, 2)},  # type: ignore[misc]
    **{f"edges {e:+g} px": were(lambda m, e=e: regrown(m, e, 10)) for e in (0.1, -0.1)},  # type: ignore[misc]
    **{f"stated blurred σ {s:g} px": stated(lambda m, s=s: blurred(m, s)) for s in (0.5, 1, 2)},  # type: ignore[misc]
    **{f"stated with noise of σ {s:g}": stated(lambda m, s=s: calibrated(m, s)) for s in (0.02, 0.05, 0.1, 0.2)},  # type: ignore[misc]
    "soft ones with noise of σ 0.05": both(lambda m: 0.03 + 0.9 * blurred(m, 0.5), lambda m: calibrated(m, 0.05)),
    **{f"stated {f:g} as open": stated(lambda m, f=f: f * m) for f in (0.8, 0.5)},  # type: ignore[misc]
    **{f"black level {b:+g}": read(lambda y, b=b: y + np.float32(b)) for b in (0.3, -0.3)},  # type: ignore[misc]
    **{f"unit × {u:g}": read(lambda y, u=u: y * np.float32(u)) for u in (0.001, 1000)},  # type: ignore[misc]
    "50 % clipped, not told": clipped,
    "mirrored": stated(lambda m: m[:, :, ::-1]),
    "turned by 180°": stated(lambda m: m[:, ::-1, ::-1]),
    "order begins 1 late": stated(lambda m: np.roll(m, -1, axis=0)),
    "order begins 3 late": stated(lambda m: np.roll(m, -3, axis=0)),
    "order begins 3 late, and mirrored": stated(lambda m: np.roll(m[:, :, ::-1], -3, axis=0)),
    "all at once, noise 1 %": were(everything, 0.01),
}


def run() -> None:
    """Print the table."""
    whole = bool(os.environ.get("GS2CI_WHOLE"))
    scenes = [*map(photograph, PHOTOGRAPHS), *map(simulated, SIMULATED)]
    seeds = SEEDS[: 1 if whole else int(os.environ.get("GS2CI_SEEDS", len(SEEDS)))]
    only = os.environ.get("GS2CI_CASES", "")
    print(f"{'wrong by':28s} true masks, dB   loss as stated (worst)  loss registered (worst)  changed  seconds")
    for name, case in CASES.items():
        if only not in name:
            continue
        rows, seconds, changed = [], 0.0, 0
        for scene in scenes[:2] + scenes[3:4] if whole else scenes:
            for seed in seeds:
                told, given = case(scene, seed)
                started = time.perf_counter()
                found = register(given)
                seconds += time.perf_counter() - started
                changed += found.is_changed
                rows.append(_scores(told, given, found, whole=whole))
        figures = np.array(rows)
        now, after = figures[:, 0] - figures[:, 1], figures[:, 0] - figures[:, 2]
        print(
            f"{name:28s} {figures[:, 0].mean():8.2f}  {now.mean():8.2f} ({now.max():6.2f})         {after.mean():8.2f} "
            f"({after.max():6.2f})        {changed:3d} of {len(rows)}  {seconds / len(rows):5.2f}",
            flush=True,
        )


def _scores(told: Shot, given: Shot, found: Registered, *, whole: bool) -> tuple[float, float, float]:
    """Return the PSNR told, as stated, and registered."""

    def score(shot: Shot) -> float:
        off = replace(Settings(), registration=replace(Settings().registration, mode="off"))
        views = reconstruct(shot, off).result.views if whole else gap_tv(shot)
        assert told.truth.views is not None
        return float(np.mean(psnr_per_view(views, told.truth.views)))

    return score(told), score(given), score(found.shot)
