"""An open SCPI-style command set for mask modulators behind a serial line (docs/scpi-modulator.md).

For a microcontroller or a lab computer in front of any LCoS, ferroelectric panel or moving mask. `packets` is
pure, `driver` does the I/O. Import the module you need; this file imports nothing.
"""
