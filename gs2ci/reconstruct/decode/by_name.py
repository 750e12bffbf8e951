"""The decoders with which a reconstruction may start, by name.

Here: GAP-TV, and the patch decoder in its two lengths. Not here: the decoders themselves; those of the command line
with which no reconstruction starts (`gs2ci.api.decoders`).
"""

from dataclasses import replace

from gs2ci.core.arrays import F32
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.choices import FirstLookName
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import patch_decode


def patch_settings(name: FirstLookName, start: GapTvSettings) -> PatchSettings | None:
    """Return the settings of the patch decoder for a name; None if it is not used.

    Args:
        name: Of the decoder.
        start: Settings of the decode by GAP-TV with which it starts.
    """
    if name == "gap-tv":
        return None
    return replace(PatchSettings.quick() if name == "patches-quick" else PatchSettings(), start=start)


def last_sigma(name: FirstLookName, start: GapTvSettings) -> float | None:
    """Return the noise level at which a decode ends, full scale 1; None if it is not by patches.

    Args:
        name: Of the decoder.
        start: Settings of the decode by GAP-TV with which it starts.
    """
    patches = patch_settings(name, start)
    return None if patches is None else patches.last_sigma


def decode_by_name(shot: Shot, name: FirstLookName, settings: GapTvSettings, progress: Progress | None = None) -> F32:
    """Decode one coded measurement into approximate views, [N, H, W, C] float32 in [0, 1].

    Args:
        shot: A checked shot.
        name: Of the decoder.
        settings: Of GAP-TV, with which the patch decoder begins.
        progress: Receives each iteration and its relative residual.

    Raises:
        InputError: The settings make no sense.
    """
    patches = patch_settings(name, settings)
    return gap_tv(shot, settings, progress) if patches is None else patch_decode(shot, patches, progress)
