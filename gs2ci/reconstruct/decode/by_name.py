"""The decoders with which a reconstruction may start, by name.

Here: GAP-TV, and the patch decoder in its two lengths. Not here: the decoders themselves; those of the command line
with which no reconstruction starts (`gs2ci.api.decoders`).
"""

from gs2ci.core.arrays import F32
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.choices import FirstLookName
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import patch_decode


def patch_settings(name: FirstLookName) -> PatchSettings | None:
    """Return the settings of the patch decoder for a name; None if it is not used."""
    if name == "gap-tv":
        return None
    return PatchSettings.quick() if name == "patches-quick" else PatchSettings()


def last_sigma(name: FirstLookName) -> float | None:
    """Return the noise level at which a decode of a name ends, full scale 1; None if it is not by patches."""
    patches = patch_settings(name)
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
    patches = patch_settings(name)
    if patches is None:
        return gap_tv(shot, settings, progress)
    return patch_decode(shot, patches, progress, begins=settings)
