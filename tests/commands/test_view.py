from pathlib import Path
from types import SimpleNamespace

import pytest
import tyro

from gs2ci.commands import view
from gs2ci.core.errors import StorageError
from gs2ci.evaluate import viewer


class Server:
    """Stands for viser's."""

    stopped = False
    address = "http://127.0.0.1:8081/?secret=abc"

    def stop(self):
        self.stopped = True


@pytest.fixture
def served(monkeypatch):
    """Pretend to serve until Ctrl-C, which comes at once."""
    calls, server = [], Server()

    def interrupt(_event):
        raise KeyboardInterrupt

    monkeypatch.setattr(viewer, "load_scene", lambda folder: SimpleNamespace(means=[0] * 5, camera_to_world=[0] * 3))
    monkeypatch.setattr(viewer, "serve", lambda _, **where: calls.append(where) or server)
    monkeypatch.setattr(view.threading.Event, "wait", interrupt)
    return calls, server


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        ([], {"host": "127.0.0.1", "port": 8080}),
        (["--host", "0.0.0.0", "--port", "9"], {"host": "0.0.0.0", "port": 9}),
    ],
)
def test_it_serves_until_interrupted_and_says_what_and_where(served, capsys, arguments, where):
    calls, server = served
    assert tyro.cli(view.run, args=["run", *arguments]) is None
    assert calls == [where]
    assert f"5 Gaussians, 3 cameras at {server.address}\n" in capsys.readouterr().out
    assert server.stopped


def test_what_is_no_run_is_refused_before_anything_is_served(tmp_path):
    with pytest.raises(StorageError, match="cannot be read"):
        view.run(Path(tmp_path))
