#!/usr/bin/env bash
# A good guess: siglent-oscilloscope gives each sample's time after the trigger, and a record in words of 16 bits if asked for, or refuses; its spectrum
# tells the volts of a sine, whatever the record's length, and finds the frequency of one of 1 mV. Found: it never asks for the trigger's delay: zero
# is the middle of the record, here 2 ms from the trigger. With format="WORD" it asks the scope for the same bytes and takes two for one sample:
# half as many, at the full rate, so that all is twice as fast. Magnitudes are those of the bare transform, 48 dB of 1 V for 1000 samples
# and 68 for 10000, and no peak is found below 0 dB. The scope is a stand-in that answers as Siglent's programming guide has it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps siglent-oscilloscope==0.5.1 numpy==2.4.6 scipy==1.17.1
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from siglent.analysis import FFTAnalyzer
from siglent.waveform import Waveform, WaveformData

RATE, SCALE = 1e6, 0.5  # samples a second, volts a division of 25 counts
asked = []


class Scope:
    """A scope whose screen begins 1.5 ms and ends 2.5 ms after the trigger; 40 counts from the moment 2.2 ms on, 0 before."""

    host, port = "scope", 5025
    answers = {"C1:VDIV?": "C1:VDIV 5.00E-01V", "C1:OFST?": "C1:OFST 0.00E+00V", "TDIV?": "TDIV 1.00E-04S", "SARA?": "SARA 1.00E+06Sa/s", "TRDL?": "TRDL -2.00E-03S"}
    counts = np.where(np.arange(1000) / RATE + 1.5e-3 >= 2.2e-3 - 1e-9, 40, 0).astype(np.int8)

    def query(self, command):
        asked.append(command)
        return self.answers[command]

    def write(self, command):
        asked.append(command)

    def read_raw(self):
        return b"C1:WF DAT2,#9" + f"{len(self.counts):09d}".encode() + self.counts.tobytes() + b"\n\n"


reader = Waveform(Scope())
plain, words = reader.acquire(1), reader.acquire(1, format="WORD")
edge = plain.time[(plain.voltage > 0.4).argmax()]
after = {name: float(record.time[(record.voltage > 0.4).argmax()] - record.time[0]) for name, record in (("bytes", plain), ("words", words))}
print("siglent-oscilloscope", version("siglent-oscilloscope"), f"an edge 2.2 ms after the trigger is at {edge * 1e3:.1f} ms; {len(plain.voltage)} samples, {after['bytes'] * 1e3:.2f} ms after the first; in words {len(words.voltage)}, {after['words'] * 1e3:.2f} ms; the scope was asked", sorted(set(asked)))


def spectrum(volts, samples):
    """Return the highest magnitude in dB, and the frequencies of the peaks that are found, of a sine of 50 periods."""
    time = np.arange(samples) / RATE
    result = FFTAnalyzer().compute_fft(WaveformData(time=time, voltage=volts * np.sin(2 * np.pi * 50 * RATE / samples * time), channel=1))
    return float(result.magnitude.max()), [round(float(frequency), 3) for frequency, _ in result.get_peak_frequency(1)]


peaks = {(volts, samples): spectrum(volts, samples) for volts, samples in ((1.0, 1000), (1.0, 10000), (1e-3, 1000))}
print("sines of volts and samples: dB and frequencies", {key: (round(value, 1), places) for key, (value, places) in peaks.items()})
assert len(plain.voltage) == 1000 and abs(plain.voltage.max() - 40 / 25 * SCALE) < 1e-9
assert "TRDL?" not in asked and abs(edge - 0.2e-3) < 1e-9, "times: the behaviour has changed"
assert abs(after["bytes"] - 0.7e-3) < 1e-9
assert len(words.voltage) == 500 and abs(after["words"] - 0.35e-3) < 1e-9, "words: the behaviour has changed"
assert abs(peaks[1.0, 1000][0] - 47.95) < 0.1 and abs(peaks[1.0, 10000][0] - 67.96) < 0.1, "magnitudes: the behaviour has changed"
assert np.allclose(peaks[1.0, 1000][1], [50000]) and peaks[1e-3, 1000][1] == [], "peaks: the behaviour has changed"
PY
