"""On which device work with arrays of the host is done."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context

import pytest
import torch

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
