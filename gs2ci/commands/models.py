"""`gs2ci models`: trained weights become model files.

Here: the arguments and what is printed. Not here: any network. Only `gs2ci.cli` imports this file.
"""

from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.decode.ffdnet import export_ffdnet, read_ffdnet
from gs2ci.reconstruct.decode.onnx_denoiser import OnnxDenoiser


def run(
    action: tyro.conf.Positional[Literal["export-ffdnet"]],
    weights: tyro.conf.Positional[Path],
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("ffdnet.onnx"),
    overwrite: bool = False,
) -> Path:
    """Turn trained weights into a model file for `gs2ci decode --denoiser onnx:FILE`.

    Args:
        action: export-ffdnet writes FFDNet weights, grey or colour, as an ONNX denoiser.
        weights: The weights, a PyTorch state dictionary (.pth).
        output: The model file to write.
        overwrite: Replace an earlier file at the same place.

    Returns:
        The model file.
    """
    assert action == "export-ffdnet"
    if output.exists() and not overwrite:
        raise InputError(f"{output} exists", remedy="choose another file with -o, or add --overwrite")
    network = read_ffdnet(weights)
    path = export_ffdnet(network, output)
    OnnxDenoiser(path)  # what was written must be readable
    colour = "grey" if network.channels == 1 else "colour"
    Console().print(
        f"FFDNet, {len(network.layers)} convolutions, {colour}, in [bold]{escape(str(path))}[/]", soft_wrap=True
    )
    return path
