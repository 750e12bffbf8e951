"""Where a path comes from, and what kind of path it is.

Here: the two enumerations; their values stand in reports. Not here: the sources (`sources`), the criteria (`validity`).
"""

from enum import StrEnum


class PathSource(StrEnum):
    """Where a path comes from; a plug-in has its own name, which is none of these."""

    TRACKS = "tracks"
    STAGE = "stage"
    FILE = "file"
    MATCHES = "wide"
    DISPLACEMENTS = "displacements"
    REST = "rest"
    VGGT = "vggt"


GIVEN: tuple[PathSource, ...] = (PathSource.STAGE, PathSource.FILE)
"""Sources that give the turns of the camera, which pictures of a small motion determine poorly."""
ESTIMATED: tuple[PathSource, ...] = (
    PathSource.TRACKS,
    PathSource.MATCHES,
    PathSource.DISPLACEMENTS,
)
"""Sources that estimate the path from this measurement alone."""


class Verdict(StrEnum):
    """Whether there is a path; or why depth is only a plane."""

    FULL = "full"
    ROTATION_ONLY = "rotation_only"
    STATIC = "static"
    UNSUPPORTED = "unsupported"
