"""The demonstration's rig file: which scene, camera move, masks and light.

Not here: the bench (`rigs`), the order of the demonstration (`gs2ci.commands.demo`).
"""

from pathlib import Path
from typing import Final

from gs2ci.api.options import check_number, check_seed, check_whole
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.whole_file import check_earlier, write_whole

OPEN_SHARE: Final = 0.25
# What a bright pixel of a white scene collects in an exposure: five of eight masks are open there, or more of more.
FULL_WELLS: Final = 0.95
LEAST_BRIGHT: Final = 5
MASK_S: Final = 0.02
STAGE_SPEED_MM_S: Final = 12.5
# The scene's depths are needed before the bench is built; an eighth of the resolution is enough for them.
PREVIEW: Final = 8
# What the modulator holds at one bit; two pixels of the preview; and half of its own pixels along either side.
MOST_VIEWS: Final = 400
LEAST_PX: Final = 16
MOST_PX: Final = (540, 960)

_MARK: Final = "# Written by `gs2ci demo`."
RIG: Final = """\
{mark} Take another shot: gs2ci capture --rig {path} -o shot.h5
name = "motorcycle"

[modulator]
kind = "dlpc900"
trigger_out_2_bit = "disables"
port = "simulated"

[sensor]
kind = "v4l2"
port = "simulated"
height = {height}
width = {width}
format = "RG12"           # a colour mosaic of 12 bits
black_level_dn = {black_level_dn}
full_well_e = {full_well_e}
electrons_per_dn = {electrons_per_dn}

[stage]
kind = "zaber"
port = "simulated"

[registration]
superpixel = 2

[capture]
masks = {masks}
density = {density}
seed = {seed}
mask_s = {mask_s}
axis = "x"
from_mm = {from_mm}
to_mm = {to_mm}

[optics]
full_scale_e_per_s = {rate}

[world]
scene = "motorcycle"
devices = "ideal"  # "typical" masks leak unevenly, which wants `gs2ci calibrate` first
scene_units_per_mm = {unit}
height = {height}
width = {width}
supersampling = 2
tolerance_dn = 1.0  # less than a tenth of the shot noise
seed = {seed}

[world.mount]  # only the world knows how the stage carries the camera: the path is found in the picture
x = [{direction}]
"""


def demo_rig(
    path: str | Path,
    *,
    views: int = 8,
    height: int = 272,
    width: int = 400,
    parallax_px: float = 12.0,
    seed: int = 0,
) -> Path:
    """Write the rig file of a simulated bench in front of a motorcycle, as `gs2ci demo` does.

    Args:
        path: The rig file to write; parents are created. An earlier demonstration's is replaced, any other file is not.
        views: Masks during the exposure.
        height: Height of the measurement, in pixels, a multiple of 2.
        width: Width of the measurement, in pixels, a multiple of 4.
        parallax_px: Shift of near against far points during the exposure.
        seed: Seed of masks and noise.

    Returns:
        The path.

    Raises:
        InputError: A number cannot be used.
        StorageError: Another file lies there, or writing fails.

    Example:
        >>> with gs2ci.open_rig(gs2ci.demo_rig("demo.toml", height=64, width=96)) as rig:
        ...     rig.name
        'motorcycle'
    """
    check_demo(views, height, width, parallax_px, seed)
    check_earlier(path, _MARK.encode(), "a demonstration's rig file")
    return write_rig(Path(path), views=views, size=(height, width), parallax_px=parallax_px, seed=seed)


def check_demo(views: int, height: int, width: int, parallax_px: float, seed: int) -> None:
    """Check the numbers of a demonstration.

    Raises:
        InputError: One is out of bounds.
    """
    check_whole("--views", views, 1, MOST_VIEWS)
    _check_side("--height", height, 2, MOST_PX[0])
    _check_side("--width", width, 4, MOST_PX[1])
    check_number("--parallax-px", parallax_px, 0, width)
    check_seed(seed)


def check_demo_place(folder: Path) -> None:
    """Check that a demonstration replaces nothing in a folder but an earlier one.

    Raises:
        StorageError: A rig file, shot or run there is none of a demonstration.
    """
    rig = folder / "rig.toml"
    check_earlier(rig, _MARK.encode(), "a demonstration's rig file")
    for name in () if rig.exists() else ("shot.h5", "shot.h5.partial", "run"):
        if (folder / name).exists():
            raise StorageError(
                f"{folder / name} exists, and no demonstration made it, so that it is not replaced",
                allowed="a new folder, or that of an earlier demonstration",
                remedy="choose another place with -o",
            )


def _check_side(option: str, length_px: int, step_px: int, most_px: int) -> None:
    """Check a side of the picture, which is a mosaic."""
    if not LEAST_PX <= length_px <= most_px or length_px % step_px:
        raise InputError(
            f"{option} {length_px}",
            allowed=f"a multiple of {step_px} from {LEAST_PX} to {most_px}",
            remedy=f"leave {option} out for the demonstration's own size",
        )


def write_rig(path: Path, *, views: int, size: tuple[int, int], parallax_px: float, seed: int) -> Path:
    """Write a rig file whose stage moves the camera so that near and far shift by `parallax_px`; return its path.

    Raises:
        StorageError: Writing fails.
    """
    import numpy as np

    from gs2ci.rig.config import CaptureTable
    from gs2ci.rig.patterns import draw_codes
    from gs2ci_drivers.planning import BRIGHT_SHARE
    from gs2ci_sims.path import stage_move_for_parallax
    from gs2ci_sims.scenes.rgbd import motorcycle
    from gs2ci_sims.sensor import SensorFigures

    sensor = SensorFigures()
    duration_s = views * MASK_S
    preview = motorcycle((size[0] // PREVIEW, size[1] // PREVIEW))
    move = stage_move_for_parallax(preview, parallax_px / PREVIEW, duration_s)
    baseline = np.array(move.velocity) * duration_s
    travel_mm = STAGE_SPEED_MM_S * duration_s
    length = float(np.linalg.norm(baseline))
    opened = draw_codes(CaptureTable(masks=views, density=OPEN_SHARE, seed=seed), size, path.parent).sum(axis=0)
    bright = max(LEAST_BRIGHT, float(np.quantile(opened[opened > 0], BRIGHT_SHARE, method="higher")))
    direction = baseline / length if length else np.array([1.0, 0.0, 0.0])
    return write_whole(
        path,
        RIG.format(
            mark=_MARK,
            path=path,
            height=size[0],
            width=size[1],
            black_level_dn=sensor.black_level_dn,
            full_well_e=sensor.full_well_e,
            electrons_per_dn=sensor.electrons_per_dn,
            direction=", ".join(f"{part:.6f}" for part in direction),
            masks=views,
            density=OPEN_SHARE,
            mask_s=MASK_S,
            from_mm=75.0 - travel_mm / 2,
            to_mm=75.0 + travel_mm / 2,
            rate=FULL_WELLS / bright * sensor.full_well_e / MASK_S,
            unit=max(length, 1e-9) / travel_mm,
            seed=seed,
        ),
        parents=True,
    )
