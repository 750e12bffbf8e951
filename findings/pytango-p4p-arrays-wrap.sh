#!/usr/bin/env bash
# A good guess: PyTango refuses an array of numbers that do not fit into an attribute of 16-bit counts, as it refuses each of them alone
# and a list of them ("Value is too large"); and p4p (EPICS' pvAccess) refuses 70000 for a channel of 16 bits. Found: of arrays PyTango
# takes what is left: [70000, -1] becomes [4464, 65535] and fractions are cut, from the client and from the device, whose sum of
# pictures comes out dark where it was brightest. p4p takes 70000 as 4464, 2.7 as 2 and NaN as 0, and arrays likewise; lists of such numbers not.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pytango==10.3.1 p4p==4.3.0 numpy==2.4.6
v/bin/python - <<'PY'
import math
from importlib.metadata import version

import numpy as np
from p4p.client.thread import Context
from p4p.nt import NTScalar
from p4p.server import Server
from p4p.server.thread import SharedPV
from tango import AttrWriteType
from tango.server import Device, attribute
from tango.test_context import DeviceTestContext


class Camera(Device):
    counts_now = 0
    limits_now = np.zeros(2, np.uint16)

    @attribute(dtype=np.uint16, access=AttrWriteType.READ_WRITE)
    def counts(self):
        return self.counts_now

    @counts.write
    def counts(self, value):
        self.counts_now = value

    @attribute(dtype=(np.uint16,), max_dim_x=8, access=AttrWriteType.READ_WRITE)
    def limits(self):
        return self.limits_now

    @limits.write
    def limits(self, values):
        self.limits_now = values

    @attribute(dtype=((np.uint16,),), max_dim_x=8, max_dim_y=8)
    def summed(self):
        return 4 * np.array([[16000, 16383], [16384, 16400]], np.int32)


def put_by_tango(camera, name, value):
    try:
        camera.write_attribute(name, value)
    except (OverflowError, TypeError):
        return "refused"
    return np.asarray(camera.read_attribute(name).value).tolist()


with DeviceTestContext(Camera, process=False) as camera:
    alone = [put_by_tango(camera, "counts", value) for value in (70000, -1, 2.7)]
    listed = put_by_tango(camera, "limits", [70000, -1])
    arrays = [put_by_tango(camera, "limits", np.array(values)) for values in ([70000, -1], [2.7, 1e5])]
    summed = camera.summed.tolist()
print("pytango", version("pytango"), "16-bit counts 70000, -1 and 2.7 alone:", alone, "the list [70000, -1]:", listed)
print("arrays [70000, -1] and [2.7, 1e5]:", arrays, "a device's sum of four pictures:", summed)
assert alone == ["refused"] * 3 and listed == "refused", "PyTango's refusals: the behaviour has changed"
assert arrays == [[4464, 65535], [2, 34464]], "PyTango's arrays: the behaviour has changed"
assert summed == [[64000, 65532], [0, 64]], "PyTango's pictures: the behaviour has changed"


def put_by_p4p(kind, value):
    channel = SharedPV(nt=NTScalar(kind), initial=[] if kind.startswith("a") else 0)

    @channel.put
    def write(channel, operation):
        channel.post(operation.value())
        operation.done()

    with Server(providers=[{"counts": channel}], isolate=True) as server:
        with Context("pva", conf=server.conf(), useenv=False) as client:
            try:
                client.put("counts", value)
            except OverflowError:
                return "refused"
            return np.asarray(client.get("counts")).tolist()


alone = [put_by_p4p("H", value) for value in (70000, -1, 2.7, math.nan)]
listed, array = put_by_p4p("aH", [70000, -1]), put_by_p4p("aH", np.array([70000, -1]))
print("p4p", version("p4p"), "16-bit counts 70000, -1, 2.7 and NaN alone:", alone, "the list [70000, -1]:", listed, "the array:", array)
assert alone == [4464, 65535, 2, 0] and listed == "refused" and array == [4464, 65535], "p4p: the behaviour has changed"
PY
