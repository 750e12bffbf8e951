"""The command line: which subcommands there are, and what their errors look like. Parsing only.

Each subcommand is one file in `gs2ci.commands`. Not here: any work. Only the console script imports this file.
"""

import os
import sys

# torch's and Numba's thread pools otherwise spin against each other (3-10x slower when anything else runs);
# OpenMP reads this when it is first loaded, hence before any other import.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def main() -> int:
    """Run the command line; return the exit status (2 for a typed error of ours)."""
    return 0


if __name__ == "__main__":
    sys.exit(main())
