"""gs2ci: hardware-in-the-loop snapshot compressive imaging.

Here is only the version. Everything else is imported from the module that defines it (`gs2ci.core.storage`,
`gs2ci.render.gaussians`, `gs2ci.reconstruct.pipeline`, ...), so that importing one part never loads another.
"""

__version__ = "0.1.0"
