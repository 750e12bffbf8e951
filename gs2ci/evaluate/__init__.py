"""Metrics, figures and reports: how good a result is, and what it cost.

The package itself can be called: `gs2ci.evaluate(run, shot)` is `gs2ci.api.scoring.evaluate`.
"""

from gs2ci.callable_package import make_callable

make_callable(__name__, "gs2ci.api.scoring", "evaluate")
