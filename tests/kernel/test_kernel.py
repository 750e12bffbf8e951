"""The drivers against a real kernel, each in a fresh guest; what is asserted stands in `guest/check_*.py`."""

from collections.abc import Callable

InGuest = Callable[..., None]


def test_v4l2_captures_from_vivid_in_every_format_and_survives_its_faults(in_guest: InGuest) -> None:
    in_guest("check_vivid.py", "vivid n_devs=2 node_types=0x1,0x1 num_inputs=1,1 input_types=0,0 multiplanar=1,2")


def test_regions_and_gates_are_set_as_the_kernel_takes_them(in_guest: InGuest) -> None:
    hdmi_that_crops = "vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=3 ccs_cap_mode=1"
    in_guest("check_region_and_level.py", hdmi_that_crops)


def test_rows_survive_full_disks_and_limits_on_files(in_guest: InGuest) -> None:
    in_guest("check_storage.py")


def test_our_own_frames_come_back_byte_exact_through_v4l2loopback(in_guest: InGuest) -> None:
    in_guest("check_loopback.py", "v4l2loopback video_nr=50 exclusive_caps=0")


def test_the_dlpc900_uploads_and_runs_a_sequence_over_usbfs(in_guest: InGuest) -> None:
    in_guest("check_dlpc900.py", "vhci-hcd", "usbhid", "hid-generic")


def test_stages_move_over_real_ttys(in_guest: InGuest) -> None:
    in_guest("check_tty.py")
