"""From one coded measurement to views, camera path and Gaussian scene. Imports neither drivers nor simulators.

The package is called as the function of its name: `gs2ci.reconstruct(shot)` is `gs2ci.api.reconstruction.reconstruct`.
"""

from gs2ci.callable_package import make_callable

make_callable(__name__, "gs2ci.api.reconstruction", "reconstruct")
