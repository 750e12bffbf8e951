"""The catalogue: every hard case by family and name, as data.

A case is a bench, the changes of its measurement by hand, and the findings that the run must report. Not here: the
measurements (`benches`, `changes`), the damage of files (`damages`) and of the optimiser (`faults`), the judgement of
the outcome (`judge`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import h5py
import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.settings import Settings
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.flicker import IlluminationFlicker
from gs2ci_sims.effects.masks import FiniteContrast
from gs2ci_sims.effects.noises import RowNoise
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.stage import StageVibration
from gs2ci_sims.effects.views import LensDistortion, OpticsPsf
from gs2ci_sims.sensor import SensorFigures
from tests.stability import changes, damages, faults
from tests.stability.benches import INTERVAL_S, Bench, ahead, aside, still, to_and_fro, turning
from tests.stability.changes import Change
from tests.stability.damages import HUGE, Damage
from tests.stability.faults import Fault, ever_since, once


def as_it_is(settings: Settings) -> Settings:
    """Leave the settings as they are."""
    return settings


def in_even_light(settings: Settings) -> Settings:
    """Want the views as under even light, whatever the lamp did."""
    return replace(settings, brightness=replace(settings.brightness, light="even"))


def stage_poses(settings: Settings) -> Settings:
    """Start from the poses that the stage reported."""
    return replace(settings, poses="stage")


@dataclass(frozen=True)
class Case:
    """One measurement that is hard in one way.

    Args:
        family: Which way.
        name: How hard.
        bench: What is exposed.
        change: What is then done by hand.
        settings: What is asked of the reconstruction.
        damage: What then happens to the file.
        fault: What goes wrong inside meanwhile.
        says: Phrases that notes, or the error, must contain.
        silent: Why nothing in the measurement can show what is wrong; else a loss must come with a word.
        through_lens: What of the true views can be seen at all: the result is compared with that.
        refused: A typed error is the right outcome.
        quick: Whether the tests run it, or the table only.
        size: A size of its own, in pixels.
        iterations: A schedule of its own.
    """

    family: str
    name: str
    bench: Bench = field(default_factory=Bench)
    change: Change = changes.same
    settings: Callable[[Settings], Settings] = as_it_is
    damage: Damage = damages.none
    fault: Fault = faults.none
    says: tuple[str, ...] = ()
    silent: str = ""
    through_lens: Callable[[F32], F32] = changes.in_focus
    refused: bool = False
    quick: bool = False
    size: tuple[int, int] | None = None
    iterations: int | None = None

    @property
    def title(self) -> str:
        """Get family and name."""
        return f"{self.family}: {self.name}"


EASY = Case("easy", "eight views, a quarter open, little noise", quick=True)
PERMUTED = "each view is another's, and every one of them is right"
FOCAL = "a wrong focal length bends path and depth, and explains the views as well"
BENT = "all views are bent alike, and a bent scene explains them as well"
BRIGHTER = "masks that are stated dimmer make the scene brighter, and explain the readings as well"
UNTOLD = "a clipped reading looks like any other"


def _noise() -> Iterator[Case]:
    for percent in (1, 2, 5, 10, 20):
        yield Case(
            "noise",
            f"{percent} % of the brightest reading",
            change=changes.noisy(percent / 100),
            quick=percent == 20,
        )
    for photons in (400, 40, 4, 0):
        says = ("there is much noise",) if photons == 0 else ()
        yield Case("light", f"{photons} photons at full scale", Bench(photons=photons), says=says, quick=photons == 0)
    for depth in (0.1, 0.3):
        # A period of three masks and a third, as of a lamp on mains behind masks of 3 ms.
        flicker = IlluminationFlicker(depth, mains_hz=1.5)
        bench = Bench(effects=(flicker,))
        # The true views are evenly lit; by default they would be handed over as bright as they were seen.
        yield Case("light", f"a lamp that swings by {depth:.0%}", bench, settings=in_even_light, quick=depth == 0.3)


def _views() -> Iterator[Case]:
    for count in (2, 3, 4, 6, 12, 16, 24, 32, 48, 64):
        yield Case("views", f"{count}", Bench(views=count), quick=count in (2, 16))


def _masks() -> Iterator[Case]:
    for share in (0.02, 0.05, 0.1, 0.4, 0.5, 0.6, 0.75, 0.9, 0.98):
        yield Case("mask ratio", f"{share:g}", Bench(open_share=share), quick=share in (0.02, 0.98))
    yield Case("masks", "grey, even in [0, 1]", Bench(kind="grey"), quick=True)
    yield Case("masks", "a laboratory's: blurred and leaking", Bench(kind="laboratory"))
    for contrast in (25.0, 5.0, 2.0):
        yield Case("masks", f"contrast {contrast:g}:1", Bench(effects=(FiniteContrast(contrast),)))
    for side in (2, 4, 8):
        yield Case("masks", f"elements of {side} px", Bench(feature_px=side))
    for groups in (4, 2, 1):
        says = ("All masks are the same",) if groups == 1 else ()
        yield Case(
            "masks",
            f"8 views, {groups} different of 8 masks",
            change=changes.duplicated(groups),
            says=says,
        )


def _wrong_masks() -> Iterator[Case]:
    for pixels in (0.25, 0.5, 1, 2, 4):
        yield Case("wrong masks", f"shifted by {pixels:g} px", change=changes.shifted(pixels), quick=pixels == 4)
    for sigma in (0.5, 1, 2):
        yield Case("wrong masks", f"blurred, σ {sigma:g} px", change=changes.blurred(sigma))
    yield Case("wrong masks", "binary instead of a laboratory's", Bench(kind="laboratory"), changes.crisp)
    for name, order in (
        ("backwards", changes.backwards),
        ("two swapped", changes.two_swapped),
        ("shuffled", changes.shuffled),
    ):
        yield Case("wrong masks", name, change=changes.permuted(order), silent=PERMUTED, quick=name == "shuffled")
    for sigma in (0.05, 0.2):
        yield Case(
            "wrong masks",
            f"calibrated with noise of {sigma:g}",
            change=changes.miscalibrated(sigma),
        )
    for share in (0.8, 0.5):
        silent = BRIGHTER if share == 0.8 else ""
        yield Case("wrong masks", f"stated {share:g} as open", change=changes.dim(share), silent=silent)
    for spread in (0.05, 0.3):
        yield Case(
            "wrong masks", f"weights off by up to {spread:.0%}", change=changes.reweighted(spread), quick=spread == 0.3
        )


def _readout() -> Iterator[Case]:
    for percent in (1, 5, 10, 25, 50):
        says = (f"{percent}% of the pixels are saturated",) if percent > 5 else ()
        yield Case("saturation", f"{percent} %", change=changes.saturated(percent / 100), says=says)
    for percent in (10, 50):
        yield Case(
            "saturation",
            f"{percent} %, not told",
            change=changes.saturated(percent / 100, told=False),
            silent=UNTOLD,
            quick=percent == 50,
        )
    for rows, every, told in (
        (1, 1, False),
        (4, 1, False),
        (48, 8, False),
        (48, 4, False),
        (4, 1, True),
        (24, 1, True),
    ):
        name = (
            f"{rows // every} dead row{'s' * (rows > 1)}"
            + (f", one in {every}" if every > 1 else "")
            + (", told" if told else "")
        )
        change = changes.dead_rows(8, 8 + rows, every=every, told=told)
        yield Case(
            "sensor",
            name,
            change=change,
            says=("No mask opens",) if told else (),
            quick=every == 4,
        )
    for share in (0.001, 0.01, 0.05):
        yield Case("sensor", f"{share:.1%} hot pixels", change=changes.hot_pixels(share, 4.0), quick=share == 0.01)
    yield Case("sensor", "row noise of 100 e", Bench(effects=(RowNoise(100.0),)))
    for by in (0.05, 0.3, -0.3):
        yield Case("sensor", f"dark level off by {by:g}", change=changes.offset(by), quick=by == -0.3)
    for bits in (4, 6, 8, 10, 14, 16):
        sensor = SensorFigures(bits=bits, electrons_per_dn=10700 / 2**bits / 0.95, black_level_dn=2**bits / 64)
        yield Case("bits", f"{bits}", Bench(sensor=sensor), quick=bits == 8)
    deep = SensorFigures(full_well_e=2e6, bits=16, electrons_per_dn=32.0)
    for scene in ("lamp", "sun"):
        yield Case(
            "high dynamic range",
            f"a {scene}, clipped",
            Bench(scene, parallax_px=0.0, path=aside(0.05)),
            quick=scene == "sun",
        )
        bright = Bench(scene, parallax_px=0.0, path=aside(0.05), sensor=deep, photons=4000.0)
        yield Case("high dynamic range", f"a {scene}, 16 bit and a deep well", bright)


def _scenes() -> Iterator[Case]:
    for scene in ("grey wall", "black wall", "soft gradient", "chequerboard", "stripes", "spots"):
        yield Case("scene", scene, Bench(scene, path=aside(0.05)), quick=scene in ("black wall", "chequerboard"))
    for scene in ("thicket", "ball", "boxes", "corridor", "motorcycle"):
        yield Case("scene", scene, Bench(scene), quick=scene == "thicket")
    for speed in (0.15, 0.6, 2.0):
        thing = ObjectMotion((-0.4, -0.25, 3.0), 0.45, (speed / (8 * INTERVAL_S), 0.3 * speed / (8 * INTERVAL_S), 0.0))
        yield Case("moving object", f"{speed:g} units, 3 away", Bench("moving", effects=(thing,)), quick=speed == 0.6)


def _motion() -> Iterator[Case]:
    yield Case("motion", "none", Bench(path=still), says=("depth cannot be found",))
    for degrees in (0.5, 3, 15):
        yield Case("motion", f"turns by {degrees:g}° on the spot", Bench(path=turning(degrees)))
    for share in (0.1, 0.5, 1.5):
        yield Case("motion", f"ahead by {share:g} of the nearest depth", Bench(path=ahead(share)), quick=share == 0.5)
    for pixels in (0.3, 1, 8, 16, 32):
        yield Case("motion", f"{pixels:g} px of parallax", Bench(parallax_px=pixels), quick=pixels == 16)
    yield Case("motion", "out of the scene", Bench(path=aside(4.0)), quick=True)
    for turns in (1, 4):
        yield Case("motion", f"to and fro, {turns} turns", Bench(path=to_and_fro(turns)), quick=turns == 4)
    shaking = StageVibration(0.02, 40.0)
    yield Case("motion", "shaking", Bench(effects=(shaking,)))
    yield Case(
        "motion", "out of focus, σ 1.5 px", Bench(effects=(OpticsPsf(1.5),)), through_lens=changes.out_of_focus(1.5)
    )


def _camera() -> Iterator[Case]:
    for factor in (0.5, 0.7, 1.4, 2.0):
        yield Case(
            "camera",
            f"focal length off by {factor:g}",
            change=changes.focal(factor),
            silent=FOCAL,
            quick=factor == 0.5,
        )
    yield Case("camera", "focal length not known", change=changes.no_camera, says=("focal length",))
    yield Case("camera", "off centre by a fifth", change=changes.off_centre(0.2), silent=FOCAL)
    bent = Bench(effects=(LensDistortion(-0.2),))
    yield Case("camera", "distortion of -0.2, known", bent)
    yield Case("camera", "distortion of -0.2, not told", bent, changes.no_distortion, silent=BENT)
    for name, factor in (("right", 1.0), ("of another unit", 1e6), ("mirrored", -1.0), ("at rest", 0.0)):
        change = changes.telemetry(changes.translations(factor))
        says = ("No geometry from stage", "The tracks are used instead") if name in ("mirrored", "at rest") else ()
        yield Case(
            "stage",
            f"poses {name}",
            change=change,
            settings=stage_poses,
            says=says,
            quick="of" in name or name == "mirrored",
        )
    for name, way in (("right", changes.astray(0.0)), ("off by 5 %", changes.astray(0.05))):
        yield Case("stage", f"poses {name}, or tracks", change=changes.telemetry(way), says=("Geometry from",))
    for name, way in (("off by half", changes.astray(0.5)), ("mirrored", changes.translations(-1.0))):
        says = ("Geometry from", "[stage.mount]")
        yield Case(
            "stage", f"poses {name}, or tracks", change=changes.telemetry(way), says=says, quick=name == "mirrored"
        )
    claimed = changes.telemetry(changes.moving(0.02))
    yield Case(
        "stage", "a move that was none, or tracks", Bench(path=still), claimed, says=("Geometry from",), quick=True
    )


def _shapes() -> Iterator[Case]:
    yield Case("size", "16 × 16", size=(16, 16), quick=True)
    yield Case("size", "31 × 17", size=(31, 17))
    yield Case("size", "8 × 200", size=(8, 200))
    yield Case("size", "1023 × 769", Bench(views=4), size=(1023, 769), iterations=40)
    yield Case("channels", "one", change=changes.mono)
    yield Case("channels", "one behind a colour filter array", Bench(effects=(BayerFilter(),)), quick=True)


def _numbers() -> Iterator[Case]:
    """Extremes of float32 and float64 in every field of the record and its file."""
    least, tiny, huge = 1e-45, float(np.finfo(np.float32).tiny), 3e38
    unit = "times full scales of one view"
    yield _number("measurement × 1e-30", changes.scaled(1e-30), says=(unit,))
    yield _number("measurement × 0.001", changes.scaled(1e-3), says=(unit,))
    yield _number("measurement × 1000", changes.scaled(1e3), says=(unit,))
    yield _number("measurement × 1e30", changes.scaled(1e30), refused=True)
    for value in (least, tiny, -tiny, huge, -huge):
        yield _number(f"a reading of {value:.1g}", changes.one_pixel("measurement", value), refused=abs(value) == huge)
    for value in (least, tiny):
        yield _number(f"a mask element of {value:.1g}", changes.one_pixel("masks", value))
        yield _number(f"all masks × {value:.1g}", changes.scaled_masks(value), refused=True)
    for value in (least, 1e-4, 1e3, huge):
        says = ("Hardly any light reached views",) if value != huge else ()
        yield _number(f"a weight of {value:.1g}", changes.one_pixel("weights", value), says=says, refused=value == huge)
    for value in (1e-300, 1e-3, 1e9, 1e300):
        yield _number(
            f"focal length {value:g}", changes.camera(value, 0.5), silent=FOCAL, refused=not 1e-9 < value < 1e99
        )
    for value in (-1e30, 1e4, 1e300):
        yield _number(
            f"principal point at {value:g} widths", changes.camera(50.0, value), silent=FOCAL, refused=value != 1e4
        )
    for value in (np.nan, 1e-300, -1e3, 1e12, 1e300):
        yield _number(f"a distortion of {value:g}", changes.lens(value), refused=value != 1e-300)
    for value in (1e-300, 1e9, 1e300):
        moved = changes.telemetry(changes.translations(value))
        yield _number(f"stage poses × {value:g}", moved, settings=stage_poses, refused=value == 1e300)
    yield _number("stage poses that stretch", changes.telemetry(changes.stretched), settings=stage_poses, refused=True)
    for value in (huge, -huge, least):
        yield _number(f"true views of {value:.1g}", changes.true_views(value), silent="the truth is never read")
    for name in ("measurement", "masks", "weights", "intrinsics"):
        for value in (np.nan, np.inf, -np.inf):
            yield _number(f"{value:g} in the {name}", changes.one_pixel(name, value), refused=True)
    for name, value in (("masks", 1.5), ("masks", -1e-3), ("weights", -1.0), ("intrinsics", 0.0)):
        yield _number(f"{value:g} in the {name}", changes.one_pixel(name, value), refused=True)
    yield _number("masks of nothing", changes.scaled_masks(0.0), refused=True)


def _number(name: str, change: Change, **options: Any) -> Case:
    """Make a case of one extreme number: small, short, few views, as nothing but its survival is asked for."""
    return Case("numbers", name, Bench(views=4), change, size=(24, 32), iterations=20, quick=True, **options)


def _files() -> Iterator[Case]:
    """What is no whole file of ours: one typed error, in little memory."""
    yield _file("empty", damages.overwritten(b""))
    yield _file("no HDF5 at all", damages.overwritten(b"PK" + bytes(5000)))
    for share in (0.1, 0.5, 0.99):
        yield _file(f"cut short to {share:.0%}", damages.cut(share))
    yield _file("one bit in every 500 bytes flipped", damages.flipped(500))
    yield _file("a later version", damages.of_schema("gs2ci.capture/2"), "newer gs2ci")
    yield _file("another program's", damages.of_schema("nexus"), "gs2ci import")
    for key in ("meas", "masks", "calib/weights"):
        yield _file(f"without {key}", damages.without(key), key)
    yield _file("masks that claim 16 TiB", damages.claiming("masks/calib", (4, HUGE, HUGE), (1, 64, 64)), "claims")
    yield _file("10¹² measurements", damages.claiming("meas", (10**12, 48, 64, 3), (1, 48, 64, 3)))
    yield _file("a chunk that unpacks to 1 GB", damages.in_one_chunk("masks/calib", (8, 48, 64), 30_000), "claims")
    yield _file("a link to itself", damages.linked("masks/calib", h5py.SoftLink("/masks/calib")), "link")
    yield _file("a link to another file", damages.linked("meas", h5py.ExternalLink("elsewhere.h5", "/x")), "link")
    yield _file("pixels that lie in another file", damages.in_another_file, "another file")
    yield _file("a book instead of weights", damages.of_text("calib/weights"))


def _file(name: str, damage: Damage, *says: str) -> Case:
    return Case("file", name, damage=damage, says=says, refused=True, quick=True, size=(48, 64))


def _faults() -> Iterator[Case]:
    """What goes wrong inside the optimiser: the last good state, and a sentence."""
    back, over = ("back to iteration",), ("diverged",)
    nan, inf = float("nan"), float("inf")
    yield _fault("a NaN in the gradient", faults.gradient(nan, once(33)), ("was not finite", *back))
    yield _fault("an infinity in the gradient", faults.gradient(inf, once(33)), ("was not finite", *back))
    yield _fault("an infinite loss", faults.loss(inf, once(33)), ("was not finite", *back))
    yield _fault("NaN in every gradient from the 33rd on", faults.gradient(nan, ever_since(33)), (*back, *over))
    yield _fault("NaN in the first gradient", faults.gradient(nan, once(0)), ("first iteration",), refused=True)
    for name, factor in (
        ("means", 1e6),
        ("log_scales", -1e3),
        ("colours", 1e20),
        ("opacity_logits", 1e4),
        ("means", nan),
    ):
        # Opaque and transparent Gaussians still show the scene: the loss does not triple, and the fit recovers.
        says = () if name == "opacity_logits" else back
        yield _fault(f"a step that multiplies {name} by {factor:g}", faults.parameter(name, factor, once(33)), says)
    yield _fault("poses thrown out of the scene", faults.poses(1e3, once(33)), back)
    yield _fault("steps that explode again and again", faults.parameter("means", 1e6, ever_since(33)), (*back, *over))


def _fault(name: str, fault: Fault, says: tuple[str, ...], *, refused: bool = False) -> Case:
    """Make a case of one fault of the optimiser: few views, and as long as the fault takes to come and go.

    The pictures are as small as held-out pixels permit: 15 of them, in 24 x 32 px, do not tell a broken scene from a
    decode.
    """
    bench = Bench(views=4)
    return Case("fault", name, bench, fault=fault, says=says, refused=refused, quick=True, size=(36, 48), iterations=50)


IMAGE_FAMILIES = (_noise, _views, _masks, _wrong_masks, _readout, _scenes, _motion, _camera, _shapes)
SURVIVAL_FAMILIES = (_numbers, _files, _faults)
CASES: tuple[Case, ...] = (
    EASY,
    *(case for family in (*IMAGE_FAMILIES, *SURVIVAL_FAMILIES) for case in family()),
)
