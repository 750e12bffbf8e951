#!/usr/bin/env bash
# A good guess: PI's own pipython sets the data recorder of a motor controller to the sampling time that it is given, where that is a whole
# number of the controller's cycles: at cycles of 50 us 0.15 ms are three. Found: what floating point leaves of the quotient is cut off, not
# rounded: 0.15 ms is set as 0.1, 0.3 as 0.25, 0.6 as 0.55, of the first hundred whole numbers 27 one lower; and, at cycles of 20 us, 100 Hz
# as 100.2. It says so if asked for its time again. Seen at a C-863 that a socket plays.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pipython==2.11.0.6 pyusb==1.2.1 pyserial==3.5
v/bin/python - <<'PY'
import socket
import threading
from importlib.metadata import version

from pipython import GCS2Device, datarectools
from pipython.pidevice.interfaces.pisocket import PISocket

HELP = ["The following commands are valid:", "*IDN? Get Device Identification", "RTR <RecordTableRate>", "RTR? Get Record Table Rate"]
ANSWERS = {
    "*IDN?": "(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-863.11, 0113000000, 1.2.1.0\n",
    "ERR?": "0\n",
    "CSV?": "2.0\n",
    "HLP?": " \n".join([*HELP, "end of help"]) + "\n",
}
rates = []  # in cycles of the controller, as they are set
server = socket.create_server(("127.0.0.1", 0))


def answer():
    port, _ = server.accept()
    waiting = ""
    while received := port.recv(4096):
        *lines, waiting = (waiting + received.decode("latin-1")).split("\n")
        for line in lines:
            line = line.lstrip("\x05\x07\x08\x18")  # single characters that ask for the state of motion or stop it
            if line.startswith("RTR "):
                rates.append(int(line[4:]))
            elif line in ANSWERS:
                port.sendall(ANSWERS[line].encode())


threading.Thread(target=answer, daemon=True).start()
device = GCS2Device(gateway=PISocket(host="127.0.0.1", port=server.getsockname()[1]))
recorder = datarectools.Datarecorder(device)
recorder.servotime = 50e-6
asked = [0.1e-3, 0.15e-3, 0.3e-3, 0.5e-3, 0.6e-3]
told = []
for time_s in asked:
    recorder.sampletime = time_s
    told.append(round(1000 * recorder.sampletime, 6))
found = list(rates)
print("pipython", version("pipython"), "cycles of 50 us, set for 0.1, 0.15, 0.3, 0.5 and 0.6 ms:", found, "told, in ms:", told)
assert found == [2, 2, 5, 10, 11] and told == [0.1, 0.1, 0.25, 0.5, 0.55], "the behaviour has changed"

rates.clear()
for cycles in range(1, 101):
    recorder.sampletime = round(cycles * 50e-6, 9)
lower = sum(rate == cycles - 1 for cycles, rate in enumerate(rates, 1))
print("of 1 to 100 cycles set one lower:", lower)
assert lower == 27 and sum(rate == cycles for cycles, rate in enumerate(rates, 1)) == 73, "the behaviour has changed"

recorder.servotime = 20e-6
recorder.samplefreq = 100
print("cycles of 20 us, set for 100 Hz:", rates[-1], f"which is {recorder.samplefreq:.2f} Hz")
assert rates[-1] == 499, "the behaviour has changed"
PY
