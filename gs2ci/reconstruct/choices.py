"""The words and limits by which a user chooses settings: what a command line needs to know of a reconstruction.

Here: names alone, so that help and error messages do not wait for heavy libraries to load. Not here: what a name
stands for (`presets`, `paper.proxies.routing`, `fit.rules`, `learned.onnx_models`).
"""

from enum import StrEnum
from typing import Final, Literal, get_args

PresetName = Literal["draft", "standard", "paper"]

PoseSource = str
"""auto, tracks, stage, wide, displacements, rest, file:PATH, vggt, vggt:FILE or vggt-or-tracks."""

ProxyName = Literal["gap-tv", "naive", "eni", "amdi", "routed"]
"""Decoded views; the masked measurement; the paper's proxies by name; or the one that the masks call for."""

FirstLookName = Literal["gap-tv", "patches", "patches-quick"]
"""The decoders that a reconstruction may begin with."""


class Decoder(StrEnum):
    """The same as an enumeration."""

    GAP_TV = "gap-tv"
    PATCHES = "patches"
    PATCHES_QUICK = "patches-quick"


DecodeMethod = str
"""One of `DECODE_METHODS`, onnx:FILE, or the name of a plug-in."""
DECODE_METHODS: Final = (
    "gap-tv",
    "patches",
    "patches-quick",
    "pnp-gap",
    "video-decoder",
    "proxies",
    "eni",
    "amdi",
)
DECODER_GROUP: Final = "gs2ci.decoders"

RULE_NAMES: Final = ("osgr", "adc", "mcmc", "revised")
RuleName = str
"""osgr, adc, mcmc, revised, or the name of a plug-in."""

RegistrationMode = Literal["auto", "off"]
REGISTRATION_MODES: Final = get_args(RegistrationMode)

MotionMode = Literal["auto", "off", "on"]

LightMode = Literal["auto", "as-seen", "even"]

WithinMask = Literal["still", "moving"]


class LeftOut(StrEnum):
    """Parts without a setting of their own that can be left out, to see what they give (`mechanisms`)."""

    ADJUSTMENT_OF_POINTS = "adjustment of points"
    CANCELLING_ERRORS = "cancelling errors"
    DECODE_WEIGHS_NOISE = "decode weighs noise"
    DENSE_POLISH = "dense polish"
    DISPLACEMENTS = "displacements"
    ERRORS_OVER_TIME = "errors over time"
    MATCHES_IN_A_LONGER_DECODE = "matches in a longer decode"
    REPEATS_DECODED_TOGETHER = "repeats decoded together"
    SECOND_LOOK = "second look"
    TRACKS_SOUGHT_TWICE = "tracks sought twice"


MOST_MOMENTS: Final = 1000
"""Each is written as a picture, and for a moving scene as a scene file too."""

ModelName = Literal["vggt", "difix", "lpips", "ffdnet", "ffdnet-colour", "fastdvdnet", "video-decoder"]
MODEL_NAMES: Final = get_args(ModelName)
DENOISER_NAMES: Final[tuple[ModelName, ...]] = ("ffdnet", "ffdnet-colour", "fastdvdnet")
"""Those of `MODEL_NAMES` that plug-and-play accepts."""

MOST_FITS: Final = 64
"""Each fit holds a scene and its optimiser's state; the gain of more fits is not worth their memory."""
