"""What the script for a GPU needs beside its checkout; what is missing is said at once, not import by import.

Here: the names of packages. Not here: the parts that import them (`gpu_parts`, `gpu_whole`).
"""

import importlib.util

# By the names under which they are imported; what a pip installs for them is in docs/gpu.md.
NEEDED = ("torch", "warp", "numba", "cv2", "scipy", "skimage", "rich", "pydantic", "pycolmap")


def check() -> None:
    """End the program if packages are missing.

    Raises:
        SystemExit: Some are; all are named.
    """
    missing = [name for name in NEEDED if not _is_there(name)]
    if missing:
        raise SystemExit(f"not installed: {', '.join(missing)} (docs/gpu.md says how to bring them along)")


def _is_there(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False
