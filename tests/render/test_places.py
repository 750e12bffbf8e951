"""On which device work with arrays of the host is done."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context

import pytest
import torch

from gs2ci.core.errors import DeviceError, ResourceError
from gs2ci.render.places import working_device, working_on

CARD = torch.device("cuda:1")


@pytest.fixture(autouse=True)
def streams(monkeypatch):
    """Keep the streams that become torch's current ones, of cards that are not here."""
    entered = []

    @contextmanager
    def stream(one):
        entered.append(one)
        yield
        entered.append("left")

    monkeypatch.setattr(torch.cuda, "default_stream", lambda device: f"usual stream of {device}")
    monkeypatch.setattr(torch.cuda, "stream", stream)
    return entered


def test_torchs_work_is_queued_on_the_usual_stream_of_the_card(streams):
    with working_on(CARD):
        assert streams == ["usual stream of cuda:1"]
        with working_on(torch.device("cpu")):
            assert len(streams) == 1
    assert streams[1:] == ["left"]


@pytest.mark.parametrize(
    ("error", "kind", "words"),
    [
        (
            torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB.\nmore"),
            ResourceError,
            "Tried to allocate",
        ),
        (RuntimeError("Failed to allocate 1000 bytes on device 'cuda:1'"), ResourceError, "crop the shot"),
        (
            RuntimeError("CUDA error: an illegal memory access was encountered\nmore"),
            DeviceError,
            "cuda:1 failed .*illegal",
        ),
        (RuntimeError("a shape is wrong"), RuntimeError, "^a shape is wrong$"),
        (RuntimeError(), RuntimeError, "^$"),
    ],
)
def test_what_a_card_reports_is_said_and_everything_else_left_alone(error, kind, words):
    with pytest.raises(kind, match=words), working_on(CARD):
        raise error
    assert working_device() is None
    with pytest.raises(RuntimeError) as same, working_on(torch.device("cpu")):
        raise error
    assert same.value is error


def test_such_work_is_done_on_the_host_unless_a_device_is_named():
    assert working_device() is None
    with working_on(CARD):
        assert working_device() == CARD
        with working_on(torch.device("cpu")):
            assert working_device() is None
        assert working_device() == CARD
    assert working_device() is None


def test_another_thread_works_there_only_in_a_copy_of_the_context():
    with working_on(CARD), ThreadPoolExecutor(1) as pool:
        assert pool.submit(working_device).result() is None
        assert pool.submit(copy_context().run, working_device).result() == CARD
