"""What the twins leave out: every idealisation of a simulated bench, real devices' behaviour, and the switch for it.

Here: the list (docs/idealisations.md is made from it) and the selection for a bench's devices. Not here: the effect of
a switch (each twin in `gs2ci_sims.wires`, each effect), the rig file (`gs2ci.rig.config`).
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, Final


@dataclass(frozen=True)
class Idealisation:
    """One property in which a twin is better than a device.

    Args:
        device: The kind of device, in words.
        twin: The twin's behaviour by default.
        real: Real devices' behaviour.
        source: The source for that.
        key: The switch below [world] of a rig file: a key, or "effects.NAME"; "" if there is none.
        ideal: The key's default; None for an effect that is off.
        typical: The value set by `devices = "typical"`; None if no figure suits most devices.
        kinds: Kinds of modulator, sensor or stage that it applies to; empty: all.
    """

    device: str
    twin: str
    real: str
    source: str
    key: str = ""
    ideal: Any = None
    typical: Any = None
    kinds: frozenset[str] = field(default_factory=frozenset)


IDEALISATIONS: Final = (
    Idealisation(
        "camera",
        "stamps the start of exposure and flags it",
        "the kernel's drivers stamp the frame's first packet, or its end",
        "uvc_video_decode_start in uvc_video.c, cfe_sof_isr_handler in rp1-cfe/cfe.c (Linux)",
        "camera_driver",
        "twin",
        "uvcvideo",
        frozenset({"v4l2"}),
    ),
    Idealisation(
        "camera",
        "has an exact clock",
        "crystals are off by 20 to 100 ppm",
        "data sheets of crystals; the GenICam twin's clock runs 40 ppm fast by default",
        "camera_clock_ppm",
        0.0,
        40.0,
        frozenset({"v4l2"}),
    ),
    Idealisation(
        "camera",
        "starts to expose at the edge of the trigger",
        "an edge between two lines waits for the next one: half a line of 10 us on average",
        "follows from exposures that begin with a line",
        "trigger_latency_s",
        0.0,
        5e-6,
    ),
    Idealisation(
        "camera",
        "has a constant trigger latency",
        "that wait is uniformly distributed over a line: a standard deviation of 10 us / 12^(1/2)",
        "as above",
        "trigger_jitter_s",
        0.0,
        2.9e-6,
    ),
    Idealisation(
        "camera",
        "exposes exactly as long as set",
        "an IMX296 exposes for 14.26 us longer than its trigger is low",
        "Sony's data sheet, as quoted in raspberrypi/linux pull request 5560",
        "trigger_exposure_offset_s",
        0.0,
    ),
    Idealisation(
        "sensor",
        "has pixels that are all the same",
        "PRNU, DSNU, hot pixels and dark current are in each maker's EMVA 1288 report",
        "EMVA Standard 1288, Release 3.1, section 4",
        "effects.prnu",
    ),
    Idealisation(
        "DMD",
        "has mirrors that flip at once",
        "crossover takes about 3 us, settling about 10 us",
        "TI DLPA027 and the DLP6500 data sheet",
        "effects.mirror_transition",
        None,
        {"transition_s": 13e-6},
        frozenset({"dlpc900"}),
    ),
    Idealisation(
        "DMD",
        "has a lamp that follows its LED enables, so that light is in proportion to grey levels",
        "lamps that stay on light bit planes of short weight for the 105 us that the mirrors take to load",
        "DLPU018, table 2-82; e2e.ti.com, thread 953168",
        "lamp",
        "switched",
        "continuous",
        frozenset({"dlpc900"}),
    ),
    Idealisation(
        "LCoS panel",
        "shows each mask at once",
        "liquid crystals of display panels take 1 to 10 ms",
        "Yeh and Gu, Optics of Liquid Crystal Displays, section 5.3",
        "panel_response_s",
        0.0,
        3e-3,
        frozenset({"santec"}),
    ),
    Idealisation(
        "modulator",
        "is completely dark when it is off",
        "off levels of 0.017 to 0.083 of the on level",
        "measured masks of two laboratory systems",
        "effects.finite_contrast",
        None,
        {},
    ),
    Idealisation(
        "modulator",
        "has elements with sharp edges",
        "edges are blurred as by a Gaussian of 0.5 sensor pixels",
        "the same masks against their binarised copies",
        "effects.mask_edges",
        None,
        {"sigma_px": 0.5},
    ),
    Idealisation(
        "relay",
        "images each element onto its pixel without error",
        "shifts, rotations and magnifications depend on the adjustment",
        "each bench's own calibration",
        "effects.misregistration",
    ),
    Idealisation(
        "GRBL controller",
        "keeps running when its port is opened",
        "an Arduino Uno resets when DTR rises: at the first opening of its port after it was plugged in",
        "100 nF between DTR and RESET in the Uno's schematic; Linux raises DTR on open, the driver leaves it up",
        "grbl_board",
        "plain",
        kinds=frozenset({"grbl"}),
    ),
    Idealisation(
        "stage",
        "reports its true position",
        "backlash, pitch error, following error and repeatability are in each maker's data sheet",
        "ISO 230-2",
        "mechanics",
        {},
    ),
    Idealisation(
        "stage",
        "moves without vibration of the camera",
        "motors and floors vibrate; the amplitude depends on the optical table",
        "each bench's own accelerometer",
        "effects.stage_vibration",
    ),
    Idealisation(
        "lamp",
        "is steady",
        "lamps drift while they warm up and flicker at twice the mains",
        "IEEE 1789-2015, section 3",
        "lamp_drift_per_min",
        0.0,
    ),
    Idealisation(
        "ports",
        "answer after a constant time",
        "the response time of an operating system varies",
        "any scheduler; late answers are among the faults (docs/faults.md)",
    ),
    Idealisation(
        "DMD",
        "begins a sequence 500 us after the command",
        "the controller's firmware takes a time that TI does not state",
        "DLPU018 gives no figure; captures wait for the first trigger and do not depend on it",
        "dlpc900_start_s",
        500e-6,
        kinds=frozenset({"dlpc900"}),
    ),
    Idealisation(
        "host",
        "shares one clock with the bench, and its computations take no time on it",
        "computers need time for every statement",
        "time in the simulated world passes only while a program waits on its clock",
    ),
)


def typical(kinds: Collection[str]) -> Iterator[Idealisation]:
    """List the idealisations of these kinds of devices for which a figure suits most real devices."""
    for one in IDEALISATIONS:
        if one.typical is not None and (not one.kinds or one.kinds & set(kinds)):
            yield one
