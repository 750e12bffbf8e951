"""Metrics, figures and reports: how good a result is, and what it cost.

The package is called as the function of its name: `gs2ci.evaluate(run, shot)` is `gs2ci.api.judging.evaluate`.
"""

from gs2ci.callable_package import make_callable

make_callable(__name__, "gs2ci.api.judging", "evaluate")
