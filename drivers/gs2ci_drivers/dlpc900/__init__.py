"""TI DLPC900 digital-mirror controller (DLP6500, DLP9000, DLP670S, DLP500YX class) over USB HID.

`packets` (messages), `lut` (sequence entries), `erle` (image coding), `images` (bit-planes to image blocks), `timing`
(what the device can do), `firmware` (where revisions differ) are pure; `driver` talks. Import the module you need; this
file imports nothing.
"""
