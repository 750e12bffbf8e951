"""Records as files of numbers and words, and back; what is none of them is refused."""

import os
import pickle
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.exposures import unfinished as packing
from gs2ci.reconstruct.exposures.unfinished import UnreadableError, key_of, packed, unpacked
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.presets.named import preset
from gs2ci.render.gaussians import Gaussians

MASKS = np.random.default_rng(0).random((3, 8, 10)).astype(np.float32)


def again(value, known=None):
    return unpacked(packed(value, "key", known), known)


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        3,
        0.1 + 0.2,
        float("inf"),
        "words · and signs",
        [1, (2.5, None), {"a": [1]}, {3: "b"}],
        frozenset({"means"}),
        Verdict.FULL,
        PathSource.STAGE,
        finding(Code.FIT_STALLED, best=5),
        preset("standard"),
    ],
)
def test_what_a_run_holds_comes_back_as_it_was(value):
    found = again(value)
    assert found == value
    assert type(found) is type(value)


def test_numbers_come_back_to_the_bit():
    odd = np.array([0.1, np.nan, -0.0, np.inf], np.float32)
    found = again(
        {"array": odd, "number": np.float64(1 / 3), "tensor": torch.from_numpy(odd), "none": torch.empty(0, 3)}
    )
    assert found["array"].tobytes() == odd.tobytes()
    assert found["tensor"].numpy().tobytes() == odd.tobytes()
    assert (type(found["number"]), found["number"]) == (np.float64, 1 / 3)
    assert found["none"].shape == (0, 3)


def test_arrays_that_are_shared_are_written_once_and_shared_again():
    once = len(packed([MASKS], "key"))
    assert len(packed([MASKS, MASKS, (MASKS,)], "key")) < once + 200
    one, other = again([MASKS, MASKS])
    assert one is other


def test_what_the_reader_has_is_not_written():
    assert len(packed([MASKS], "key", {"masks": MASKS})) < MASKS.nbytes
    assert again([MASKS], {"masks": MASKS})[0] is MASKS
    with pytest.raises(UnreadableError):
        unpacked(packed([MASKS], "key", {"masks": MASKS}))


def test_a_shot_its_holdout_and_gaussians_come_back():
    shot = Shot(MASKS.sum(axis=0)[..., None], MASKS, provenance={"source": "test"})
    holdout = again(Holdout.of(shot, 0.1, 0))
    assert np.array_equal(holdout.pixels, Holdout.of(shot, 0.1, 0).pixels)
    assert holdout.shot.provenance == {"source": "test"}
    scene = Gaussians(*(torch.rand(4, n) for n in (3, 3, 4)), torch.rand(4), torch.rand(4, 3))
    assert torch.equal(again(scene).means, scene.means)
    assert again(scene).motion is None


def test_a_file_says_what_it_is_of():
    assert key_of(packed(1, "abc")) == "abc"
    for content in (b"", b"words", b"gs2ci.unfinished/0 a b\n", b"PK" * 500):
        with pytest.raises(UnreadableError, match="no file of an unfinished run"):
            key_of(content)


def test_a_damaged_file_is_refused():
    whole = packed([MASKS], "key")
    for damaged in (whole[:-1], whole[:200], whole[:150] + b"x" + whole[151:]):
        with pytest.raises(UnreadableError, match="damaged"):
            unpacked(damaged)


@dataclass
class Foreign:
    """A record that is none of ours."""

    number: int = 1


@pytest.mark.parametrize("value", [Foreign(), Foreign, object(), [lambda: 1], again])
def test_what_is_no_record_of_ours_cannot_be_kept(value):
    with pytest.raises(TypeError, match="cannot be kept"):
        packed(value, "key")


class Made:
    """What a pickle makes by a call."""

    def __init__(self, *call):
        self._call = call

    def __reduce__(self):
        return self._call


@pytest.mark.parametrize(
    "value",
    [
        Made(os.system, ("exit 1",)),
        Made(packing.key_of, (b"",)),
        Made(packing.record, (InputError, {})),
        Made(packing.record, (Shot, {"measurement": 1})),
        Made(Code, ("no such",)),
        Made(np.load, ("nowhere",)),
        Made(torch.load, ("nowhere",)),
        Foreign(),
    ],
)
def test_a_file_that_names_anything_else_is_refused_and_runs_nothing(value):
    content = pickle.dumps(value)
    digest = packing.hashlib.sha256(content).hexdigest()
    with pytest.raises(UnreadableError, match="does not fit"):
        unpacked(packing.MARK + f" key {digest}\n".encode() + content)


def test_what_was_computed_of_a_record_is_not_written():
    shot = Shot(MASKS.sum(axis=0)[..., None], MASKS)
    before = len(packed(shot, "key"))
    vars(shot)["computed since"] = MASKS.copy()
    assert len(packed(shot, "key")) == before
