"""What importing pycolmap leaves of the process's handlers of signals: all of them."""

import os
import signal
import subprocess
import sys

import pytest

from tests.patience import HANG_S

PRELUDE = '''
import ctypes, os, signal, sys, threading, time
sigaction = ctypes.CDLL(None).sigaction

def handlers():
    """The address of each handler, with which the C library's struct begins; not all of the rest is filled in."""
    found = {}
    for number in signal.valid_signals():
        action = ctypes.create_string_buffer(1024)
        sigaction(int(number), None, action)
        found[int(number)] = ctypes.c_void_p.from_buffer(action).value
    return found

def end(number, frame):
    raise SystemExit(128 + number)
'''
# The main thread, another one, and all that a reconstruction imports.
WAYS = {
    "main": "from gs2ci.core.colmap import pycolmap",
    "thread": """
def load():
    from gs2ci.core.colmap import pycolmap
thread = threading.Thread(target=load)
thread.start()
thread.join()
""",
    "reconstruction": "import gs2ci.reconstruct.pipeline, gs2ci.evaluate.run_folder",
}
ENDING = """
signal.signal(signal.SIGTERM, end)
signal.signal(signal.SIGHUP, signal.SIG_IGN)
before = handlers()
{way}
assert "pycolmap" in sys.modules
changed = [number for number, handler in handlers().items() if handler != before[number]]
print("changed", changed, flush=True)
try:
    print("ready", flush=True)
    time.sleep(3600)
finally:
    print("unwound", flush=True)
"""


@pytest.mark.parametrize("way", WAYS)
def test_a_process_that_has_pycolmap_unwinds_when_it_is_told_to_end(way):
    pytest.importorskip("pycolmap")
    code = PRELUDE + ENDING.format(way=WAYS[way])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True) as child:
        changed, ready = child.stdout.readline(), child.stdout.readline()
        child.send_signal(signal.SIGHUP)
        child.send_signal(signal.SIGTERM)
        rest, _ = child.communicate(timeout=HANG_S)
    assert (changed, ready, rest) == ("changed []\n", "ready\n", "unwound\n")
    assert child.returncode == 128 + signal.SIGTERM
