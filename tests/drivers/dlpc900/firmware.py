"""What the firmware makes of an image's bytes. Not a test."""

from gs2ci.core.arrays import U32
from gs2ci_sims.wires.dlpc900_images import read_image


def reads(stream: bytes, width: int, height: int) -> U32:
    """Let the twin's own decoder read a stream behind a header that is typed in here."""
    header = b"\x53\x70\x6c\x64" + width.to_bytes(2, "little") + height.to_bytes(2, "little")
    header += len(stream).to_bytes(4, "little") + b"\xff" * 8 + bytes(4) + bytes([1, 2, 1])
    return read_image(header + bytes(21) + stream, width, height)
