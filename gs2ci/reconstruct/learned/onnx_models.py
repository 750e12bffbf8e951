"""Third-party model files: loading them by ONNX Runtime, and the list of those that the user has added.

Here: opening a file with a clear error for every refusal, running it and checking its answer, tracing a network into
one, and the list of models that the user has added by name. Not here: what any model takes and returns
(`onnx_denoiser`, `paper.priors2d.onnx_prior`, `vggt`). ONNX Runtime is imported when a model is loaded, the package
`onnx` when a graph is written or read.
"""

import hashlib
import importlib
import io
import json
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError, NumericsError, StorageError
from gs2ci.core.json_text import parse_json
from gs2ci.core.whole_file import write_whole
from gs2ci.reconstruct.choices import ModelName

# Networks halve their images up to three times; sides that a model leaves open are padded to a multiple of this.
SIDE_MULTIPLE: Final = 8
# The operator set of files that are written here: old enough for any ONNX Runtime since 2022.
OPSET: Final = 17


def onnx_package(doing: str = "writing ONNX models") -> Any:
    """Import the package `onnx`.

    Args:
        doing: What needs it, for the error.

    Raises:
        InputError: It is not installed.
    """
    try:
        return importlib.import_module("onnx")
    except ImportError as error:
        raise InputError(f"{doing} needs the package onnx", remedy="pip install 'gs2ci[export]'") from error


class _Traced(torch.nn.Module):
    """The module that torch's exporter asks for, around anything that is called with tensors."""

    def __init__(self, network: Callable[..., Any]) -> None:
        super().__init__()
        self._network = network

    def forward(self, *given: Tensor) -> Any:
        return self._network(*given)


def trace(
    network: Callable[..., Any],
    given: Mapping[str, Tensor],
    made: Sequence[str],
    open_axes: Mapping[str, Mapping[int, str]] | None,
    target: str | io.BytesIO,
) -> None:
    """Write what a network does with tensors as an ONNX graph.

    Args:
        network: A module, or another thing that is called with tensors; sizes that it reads from their `shape` stay
            open where their axes are.
        given: What it is called with while it is traced, by the names of the graph's inputs.
        made: The names of its outputs.
        open_axes: Axes of inputs and outputs that may have any length, with a name for each; None for no axis.
        target: A file's path, or a buffer.
    """
    with warnings.catch_warnings(), torch.no_grad():
        # Tracing warns about each of a network's assertions, and that another exporter exists.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _Traced(network).eval(),
            tuple(given.values()),
            target,  # type: ignore[arg-type]  # this exporter takes a buffer as well
            input_names=list(given),
            output_names=list(made),
            dynamic_axes=open_axes,
            opset_version=OPSET,
            dynamo=False,
        )


def write_traced(
    network: Callable[..., Any], given: Mapping[str, Tensor], axes: Mapping[str, Mapping[int, str]], path: Path
) -> Path:
    """Write a denoiser's graph with its one output `denoised` to a file, which appears whole or not at all.

    Raises:
        InputError: The package `onnx` is not installed.
        StorageError: The file cannot be written.
    """
    onnx_package()
    content = io.BytesIO()
    trace(network, given, ["denoised"], axes, content)
    return write_whole(path, content.getvalue(), parents=True)


def open_model(path: Path, remedy: str) -> Any:
    """Load a model file; returns ONNX Runtime's session, on the CPU.

    Args:
        path: The file.
        remedy: What the error advises if there is no such file.

    Raises:
        InputError: No such file, or one that ONNX Runtime refuses (damaged, of an unknown operator set).
    """
    if not path.is_file():
        raise InputError(f"no model file {path}", remedy=remedy)
    import onnxruntime  # noqa: PLC0415

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = max(1, torch.get_num_threads())
    # Spinning threads slow down all other thread pools.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4  # its errors are raised as exceptions
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise InputError(
            f"{path} cannot be loaded as an ONNX model: {first_line(error)}",
            allowed=f"what ONNX Runtime {onnxruntime.__version__} loads",
            remedy="export it again, with an operator set of this ONNX Runtime (17 is safe)",
        ) from error


def run_model(session: Any, name: str, feed: Mapping[str, Any], remedy: str) -> dict[str, Any]:
    """Run a model; returns its outputs by name.

    Raises:
        NumericsError: It failed; the error names the inputs.
    """
    names = [one.name for one in session.get_outputs()]
    try:
        return dict(zip(names, session.run(names, dict(feed)), strict=True))
    except Exception as error:
        # ONNX Runtime's exceptions have no common base class.
        shapes = ", ".join(f"{key} {list(np.shape(value))}" for key, value in feed.items())
        raise NumericsError(f"{name} failed on {shapes}: {first_line(error)}", remedy=remedy) from error


def fixed_side(side: int | str | None) -> int | None:
    """Return the length of a fixed axis, None for an open one (for which ONNX Runtime gives a name or nothing)."""
    return side if isinstance(side, int) and side > 0 else None


def first_line(error: Exception) -> str:
    """Return the first line of an exception's message, shortened."""
    return str(error).strip().split("\n", maxsplit=1)[0][:300]


class OnnxModel(ABC):
    """A model file of one kind, run by ONNX Runtime on the CPU.

    Args:
        path: The file.

    Attributes:
        inputs: What it takes, in ONNX Runtime's records.
        outputs: What it returns, likewise.

    Raises:
        InputError: No such file, a file that ONNX Runtime refuses (damaged, of an unknown operator set), or inputs and
            outputs other than those of this kind.
    """

    kind: ClassVar[str]
    """What such a file is called, with its article."""
    called: ClassVar[str]
    """What it takes."""
    missing: ClassVar[str]
    """What to do if there is no such file."""
    wrap: ClassVar[str] = "wrap the network so that it has this signature, and export it again"
    """What to do if it takes something else."""
    of: ClassVar[str] = "images"
    """What it is run on."""
    makes: ClassVar[str] = "images"
    """What it returns."""
    scaled: ClassVar[str] = "check that the model takes images with full scale 1"
    """What to do if it returns numbers that are not finite."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._session = open_model(self.path, self.missing)
        self.inputs, self.outputs = self._session.get_inputs(), self._session.get_outputs()
        if not self.is_one():
            taken = ", ".join(f"{one.name} {one.shape} {one.type}" for one in self.inputs) or "nothing"
            raise InputError(
                f"{self.path} is not {self.kind}: it takes {taken} and returns "
                f"{', '.join(one.name for one in self.outputs)}",
                allowed=self.called,
                remedy=self.wrap,
            )

    @abstractmethod
    def is_one(self) -> bool:
        """Tell by inputs and outputs whether the file is of this kind."""

    @property
    def ranks(self) -> list[int] | None:
        """Get the numbers of axes of the inputs; None if one of these is not of float32."""
        floats = all(one.type == "tensor(float)" for one in self.inputs)
        return [len(one.shape) for one in self.inputs] if floats else None

    def padded(self, stack: F32, taken: Any, mode: Literal["symmetric", "reflect"] = "symmetric") -> F32:
        """Continue pictures, [..., H, W], to the sides that an input has, to multiples of 8 where it leaves them open.

        Args:
            stack: The pictures.
            taken: The input.
            mode: How they are mirrored.

        Raises:
            InputError: A side is fixed, and smaller.
        """
        had, sides = stack.shape[-2:], [fixed_side(side) for side in taken.shape[-2:]]
        if any(side is not None and side < size for side, size in zip(sides, had, strict=True)):
            raise InputError(
                f"{self.path.name} takes {self.of} of {sides[0] or 'any'} x {sides[1] or 'any'} pixels, not of "
                f"{had[0]} x {had[1]}",
                remedy="export the model with dynamic height and width",
            )
        more = [(0, side - size if side else -size % SIDE_MULTIPLE) for side, size in zip(sides, had, strict=True)]
        return np.pad(stack, [(0, 0)] * (stack.ndim - 2) + more, mode=mode)

    def answer(self, fed: Sequence[Any], wanted: tuple[int, ...], at: str = "") -> F32:
        """Run the model; return its first output.

        Args:
            fed: What it takes, in the order of its inputs; more than it has are left out.
            wanted: The shape that it should return.
            at: With which further numbers it is run, for the error.

        Raises:
            NumericsError: It failed, or returned another shape, NaN or infinity.
        """
        name, first = self.path.name, self._session.get_outputs()[0].name
        feed = {one.name: np.asarray(value, order="C") for one, value in zip(self.inputs, fed, strict=False)}
        remedy = f"check the model with {self.of} of its own; export it with dynamic height and width"
        found = np.asarray(run_model(self._session, name, feed, remedy)[first])
        if found.shape != wanted:
            raise NumericsError(
                f"{name} made {list(found.shape)} of {self.of} {list(np.shape(fed[0]))}",
                allowed=f"{self.makes}, {list(wanted)}",
            )
        if not np.isfinite(found).all():
            raise NumericsError(f"{name} returned numbers that are not finite{at}", remedy=self.scaled)
        return found.astype(np.float32, copy=False)


@dataclass(frozen=True)
class KnownModel:
    """A model file that the user has added.

    Args:
        path: Absolute.
        sha256: Of its content when it was added.
    """

    path: Path
    sha256: str


def add_model(name: ModelName, path: Path) -> KnownModel:
    """Record a model's path and checksum; an earlier record of the same name is replaced.

    Raises:
        InputError: There is no such file.
        StorageError: The list cannot be written.
    """
    if not path.is_file():
        raise InputError(f"no model file {path}", remedy="name the exported .onnx file")
    model = KnownModel(path.resolve(), _sha256(path))
    listed = {**_listed(), name: {"path": str(model.path), "sha256": model.sha256}}
    text = json.dumps(listed, indent=2) + "\n"
    write_whole(_list_path(), text, parents=True, remedy="set GS2CI_HOME to a folder of yours")
    return model


def known_model(name: ModelName) -> KnownModel | None:
    """Return the model added under a name; None if there is none.

    Raises:
        StorageError: The list cannot be read.
    """
    entry = _listed().get(name)
    return None if entry is None else KnownModel(Path(entry["path"]), entry["sha256"])


def find_model(name: ModelName) -> Path:
    """Return the file added under a name.

    Raises:
        InputError: None was added, the file is gone, or its content has changed.
        StorageError: The list cannot be read.
    """
    known, again = known_model(name), f"gs2ci models add {name} FILE"
    if known is None:
        raise InputError(f"no {name} model is known here", remedy=again)
    if not known.path.is_file():
        raise InputError(f"the {name} model {known.path} is gone", remedy=again)
    if _sha256(known.path) != known.sha256:
        raise InputError(
            f"the {name} model {known.path} is not the one that was added: its content has changed",
            allowed=f"sha256 {known.sha256}",
            remedy=f"{again}, if the new one is meant",
        )
    return known.path


def _list_path() -> Path:
    home = os.environ.get("GS2CI_HOME")
    if home:
        return Path(home) / "models.json"
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "gs2ci" / "models.json"


def _listed() -> dict[str, dict[str, str]]:
    path = _list_path()
    if not path.is_file():
        return {}
    try:
        listed: dict[str, dict[str, str]] = parse_json(path.read_text())
        complete = all({"path", "sha256"} <= entry.keys() for entry in listed.values())
    except (OSError, ValueError, AttributeError) as error:
        raise StorageError(f"cannot read {path}: {error}", remedy="repair or delete it") from error
    if not complete:
        raise StorageError(f"{path} lacks a path or sha256", remedy="repair or delete it")
    return listed


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
