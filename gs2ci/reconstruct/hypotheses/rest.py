"""A camera at rest, beside a motion that was found but that no tracks confirm.

If a scene shows only a periodic pattern or a gradient, any motion explains the measurement, and a fit from rest ends
several dB better.
"""

from dataclasses import replace

from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE
from gs2ci.reconstruct.geometry.kinds import PathSource
from gs2ci.reconstruct.geometry.sources.direct import at_rest


def needs_rest(first: FirstLook) -> bool:
    """Tell whether rest should be tried too: a motion was found, but not confirmed by tracks."""
    return first.geometry.is_uniform and first.geometry.has_path


def from_rest(first: FirstLook) -> FirstLook:
    """Return a first look as if no path had been found: a camera at rest in front of a plane."""
    rest = at_rest(first.geometry)
    return replace(first, geometry=replace(rest, source=PathSource.TRACKS, notes=(*rest.notes, PLANE_NOTE)))
