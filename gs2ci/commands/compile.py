"""`gs2ci compile`: make every kernel's machine code now. Here: what is printed."""

from gs2ci.api.preparing import compile_kernels
from gs2ci.commands.answers import AsJson, answered


def run(*, json: AsJson = False) -> float:
    """Make the machine code of all kernels, for this processor, and keep it on disk.

    Without it the first reconstruction after an installation does so, and takes so much longer.

    Returns:
        The seconds that it took.
    """
    with answered(as_text=not json) as answer:
        seconds = compile_kernels()
        print(f"All kernels are compiled ({seconds:.0f} s).")
        answer({"seconds": seconds})
    return seconds
