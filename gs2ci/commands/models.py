"""`gs2ci models`: register model files under names.

Here: the arguments and what is printed. Not here: any network.
"""

from pathlib import Path
from typing import Annotated, Final, Literal, cast

import tyro

from gs2ci.api.models import NotedModel, add_model, list_models
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import MODEL_NAMES, ModelName

Action = Literal["add", "list"]

_CALLS: Final[dict[Action, tuple[str, int]]] = {
    "add": (f"gs2ci models add {'|'.join(MODEL_NAMES)} FILE", 2),
    "list": ("gs2ci models list", 0),
}


def run(
    action: tyro.conf.Positional[Action],
    what: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    /,
    *,
    json: AsJson = False,
) -> Path | None:
    """Register files of trained networks under names.

    Args:
        action: add registers a file under a name: vggt, difix (--prior difix), lpips (--distance lpips), the denoisers
            ffdnet, ffdnet-colour and fastdvdnet (decode --denoiser NAME), or video-decoder, a network from measurement
            and masks to views (decode --method video-decoder). list shows what has been added.
        what: For add, the name and the ONNX file.

    Returns:
        The model file; None for list.

    Raises:
        Gs2ciError: A file or a name cannot be used; then nothing is written.
    """
    call, count = _CALLS[action]
    if len(what) != count:
        raise InputError(f"{action} with {len(what)} arguments", allowed=call)
    with answered(json) as answer:
        if action == "list":
            answer(_list())
            return None
        added = add_model(cast(ModelName, str(what[0])), what[1])  # a wrong name lists the valid ones
        say(f"{added.name}: ", added.path, f"\nsha256 {added.sha256}")
        answer(added)
        return added.path


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
