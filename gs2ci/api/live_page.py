"""The live page of a bench as an object: `LivePage`, which `OpenRig.live` makes.

Not here: the page (`gs2ci.rig.live`).
"""

from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from gs2ci.rig.opening import Rig


class LivePage:
    """A bench shown in the browser while the user aligns it; made by `OpenRig.live`.

    Args:
        rig: The bench.
        host: Address to listen on.
        port: Port of the local server, or the next free one; 0 for any.
    """

    def __init__(self, rig: "Rig", host: str, port: int) -> None:
        from gs2ci.rig.live.bench import LiveBench
        from gs2ci.rig.live.server import LiveServer

        self._bench = LiveBench(rig)
        self._bench.begin()
        try:
            self._server = LiveServer(self._bench, host, port)
        except BaseException:
            self._bench.close()
            raise
        self.address = self._server.address

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End serving, disarm everything and close the devices."""
        try:
            self._server.stop()
        finally:
            self._bench.close()
