"""The capture file `shot.h5`, schema gs2ci.capture/1: coded measurements with all that is needed to decode them.

    layout.py    what stands where, with which shape and unit, and the empty file
    writer.py    ShotWriter (row by row, crash-tolerant) and write_shots (finished measurements)
    reader.py    read_shot, count_shots: defensive, one typed error for whatever is wrong
    recovery.py  recover: the finished rows of a killed capture, in a new file
    sealing.py   from `.partial` to the final name, and the manifest beside it

Not here: foreign formats (`gs2ci.core.foreign`). torch is not needed.
"""

from gs2ci.core.storage.layout import SCHEMA, CaptureHeader, FrameRow
from gs2ci.core.storage.reader import count_shots, read_shot
from gs2ci.core.storage.recovery import recover
from gs2ci.core.storage.writer import ShotWriter, write_shots

__all__ = [
    "SCHEMA",
    "CaptureHeader",
    "FrameRow",
    "ShotWriter",
    "count_shots",
    "read_shot",
    "recover",
    "write_shots",
]
