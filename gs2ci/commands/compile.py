"""`gs2ci compile`: compile every kernel now. Here: what is printed."""

from gs2ci.api.preparing import compile_kernels
from gs2ci.commands.answers import AsJson, answered


def run(*, json: AsJson = False) -> float:
    """Compile all kernels for this processor, and keep the machine code on disk.

    Otherwise the first reconstruction after an installation does so, and takes longer.

    Returns:
        The seconds that it took.
    """
    with answered(json) as answer:
        seconds = compile_kernels()
        print(f"All kernels are compiled ({seconds:.0f} s).")
        answer({"seconds": seconds})
    return seconds
