"""What a fit computes on a device, in NVIDIA Warp; imported only by fits whose tensors lie on one.

Never run on a GPU.
"""

import warp as wp

wp.init()
