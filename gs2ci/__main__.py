"""`python -m gs2ci` is `gs2ci`, for where the console script is not on the path."""

import sys

from gs2ci.cli import main

sys.exit(main())
