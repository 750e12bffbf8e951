"""Random weights of a small FastDVDnet, under its authors' names."""

import torch

# Stage, number of the layer, filters out, channels in, and whether a batch normalisation follows: widths 4, 6, 8.
LAYERS = [
    ("inc.convblock.0", 6, 4, True),
    ("inc.convblock.3", 4, 6, True),
    ("downc0.convblock.0", 6, 4, True),
    ("downc0.convblock.3.convblock.0", 6, 6, True),
    ("downc1.convblock.0", 8, 6, True),
    ("downc1.convblock.3.convblock.0", 8, 8, True),
    ("upc2.convblock.0.convblock.0", 8, 8, True),
    ("upc2.convblock.1", 24, 8, False),
    ("upc1.convblock.0.convblock.0", 6, 6, True),
    ("upc1.convblock.1", 16, 6, False),
    ("outc.convblock.0", 4, 4, True),
    ("outc.convblock.3", 3, 4, False),
]


def small_state(seed=0):
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.randn(*shape, generator=generator)

    state = {}
    for step in ("temp1", "temp2"):
        for place, out, channels, norm in LAYERS:
            head, number = place.rsplit(".", 1)
            state[f"module.{step}.{place}.weight"] = 0.3 * draw(out, channels, 3, 3)
            if norm:
                after = f"module.{step}.{head}.{int(number) + 1}"
                state[f"{after}.weight"], state[f"{after}.bias"] = 1 + 0.2 * draw(out), 0.1 * draw(out)
                state[f"{after}.running_mean"], state[f"{after}.running_var"] = 0.1 * draw(out), 0.5 + draw(out) ** 2
                state[f"{after}.num_batches_tracked"] = torch.tensor(3)
    return state
