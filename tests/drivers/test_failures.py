import inspect

import pytest

from gs2ci.core.errors import DeviceError
from gs2ci_drivers import failures
from gs2ci_drivers.failures import DriverError

EXAMPLES = [
    failures.NoAnswerError("dmd0", "read status", 1.5),
    failures.BadReplyError("dmd0", "read status", b"\x00" * 99, "too long", allowed="64 bytes"),
    failures.DisconnectedError("dmd0", "read status", OSError(19, "No such device")),
    failures.AccessError("dmd0", "busy", asked="open", remedy="close it"),
    failures.RefusedError("dmd0", "start", 5, "not now"),
    failures.DeviceFaultError("dmd0", "start", ["parked", "hot"]),
    failures.MoveFailedError("stage0", "move", ["FS"]),
    failures.ReferenceLostError("stage0", "move", ["WR"]),
    failures.SequenceError("dmd0", "run", ["abort"]),
    failures.UnsupportedError("cam0", "no trigger", allowed="none", remedy="buy another"),
    failures.OutOfRangeError("stage0", "200 mm", allowed="0 to 150 mm"),
    failures.WrongStateError("cam0", "closed", remedy="open it"),
    failures.PlanRefusedError(["a is 1, allowed: 2", "b is 3, allowed: 4"]),
    failures.TriggerTimeoutError("cam0", 3, 0.5),
    failures.FrameLostError("cam0", 3, 2),
    failures.FrameCorruptError("cam0", 3, "marked"),
    failures.FrameStaleError("cam0", 3, 0.2),
    failures.ExposureError("cam0", 3, 0.08, 0.008),
    failures.ExtraFrameError("cam0", "1 more", remedy="look for reflections"),
]


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_every_error_names_its_device_and_what_to_do_or_what_is_allowed(error):
    assert isinstance(error, DeviceError)
    assert str(error).startswith(f"{error.device}: ")
    assert error.remedy or error.allowed
    assert (error.remedy or error.allowed) in str(error)


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_a_trigger_is_noted_once_and_named_in_message_and_problem(error):
    served = type(error).__new__(type(error))
    served.__dict__.update(error.__dict__)
    assert served.at_trigger(7) is served
    served.at_trigger(8)
    assert served.trigger_index == 7
    assert str(served).startswith(f"{error.device}, trigger 7: ")
    assert served.problem.startswith(f"{error.device}, trigger 7: ")


def test_the_tree_in_the_docstring_names_every_class():
    classes = [name for name, kind in inspect.getmembers(failures, inspect.isclass) if issubclass(kind, DriverError)]
    for name in classes:
        assert name in failures.__doc__
    shown = {type(error).__name__ for error in EXAMPLES}
    assert set(classes) - shown == {"DriverError", "LinkError", "FrameError"}
