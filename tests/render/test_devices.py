"""Which device renders: every answer that a computer may give, by twins of what is asked of it."""

import pytest

from gs2ci.core.errors import InputError, ResourceError
from gs2ci.core.findings import Code
from gs2ci.render import devices
from gs2ci.render.backend import load_backend
from gs2ci.render.cards import Card, Cuda
from gs2ci.render.devices import CudaProbe, RenderingPlace, compute_devices, place

NEW = Card("cuda:0", "NVIDIA H100 PCIe", (9, 0), 81559, 80000)
SECOND = Card("cuda:1", "NVIDIA GeForce RTX 4090", (8, 9), 24564, 24000)
OLD = Card("cuda:0", "NVIDIA GeForce GTX 1080", (6, 1), 8192, 8000)
FULL = Card("cuda:0", "NVIDIA GeForce RTX 4090", (8, 9), 24564, 900)


def lacks_the_extra():
    raise ModuleNotFoundError("No module named 'warp'", name="warp")


def computer(*cards, driver=(13, 0), error=1e-6, has_driver=True):
    return CudaProbe(lambda: has_driver, lambda: Cuda(driver, (13, 0), (7, 5), cards), lambda device: error)


def must_not_be_asked(*_):
    raise AssertionError("asked for nothing")


def test_a_card_that_works_is_taken_and_said():
    found = place("auto", 4000, computer(NEW, SECOND))
    assert (found.backend, found.device) == ("warp:cuda:0", "cuda:0 (NVIDIA H100 PCIe)")
    (note,) = found.notes
    assert note.code is Code.GPU_USED
    assert "have never run on a GPU" in note.sentence


def test_a_driver_that_captures_nothing_is_said_and_the_card_is_used():
    asked = CudaProbe(lambda: True, lambda: Cuda((13, 0), (13, 0), (7, 5), (NEW,)), lambda _: 1e-6, lambda: "no stream")
    found = place("auto", 4000, asked)
    assert [note.code for note in found.notes] == [Code.GPU_USED, Code.GPU_NOT_CAPTURED]
    assert "cannot be captured (no stream): each is made from Python" in found.notes[1].sentence
    assert found.backend == "warp:cuda:0"


def test_one_of_several_cards_can_be_named():
    assert place("cuda:1", 4000, computer(NEW, SECOND)).backend == "warp:cuda:1"
    assert place("cuda", 4000, computer(NEW, SECOND)).backend == "warp:cuda:0"


def test_the_first_card_that_may_serve_is_taken():
    assert place("auto", 4000, computer(OLD, SECOND)).backend == "warp:cuda:1"
    assert place("cuda", 4000, computer(FULL, SECOND)).backend == "warp:cuda:1"


def test_without_a_driver_nothing_is_imported_and_nothing_said():
    assert place("auto", 4000, CudaProbe(lambda: False, must_not_be_asked, must_not_be_asked)) == RenderingPlace()


def test_the_cpu_asks_nothing_of_the_computer():
    asked = CudaProbe(must_not_be_asked, must_not_be_asked, must_not_be_asked)
    assert place("cpu", 10**9, asked) == RenderingPlace("cpu", "cpu", ())


LACKS = {
    "extra": (
        CudaProbe(lambda: True, lacks_the_extra, must_not_be_asked),
        Code.GPU_EXTRA_MISSING,
        InputError,
        "what renders on its cards is not installed",
    ),
    "silent driver": (
        computer(driver=None),
        Code.GPU_DRIVER_SILENT,
        InputError,
        "No NVIDIA driver answers",
    ),
    "old driver": (
        computer(driver=(12, 4)),
        Code.GPU_DRIVER_OLD,
        InputError,
        r"is for CUDA 12\.4, and CUDA 13\.0 is needed",
    ),
    "no card": (
        computer(),
        Code.GPU_NOT_THERE,
        InputError,
        r"There is no CUDA device \(found: none\)",
    ),
    "old card": (
        computer(OLD),
        Code.GPU_TOO_OLD,
        InputError,
        r"GTX 1080\) has compute capability 6\.1, and 7\.5 is needed",
    ),
    "small memory": (
        computer(FULL),
        Code.GPU_MEMORY_SMALL,
        ResourceError,
        r"has 900 MiB free, and this shot needs about 4000 MiB",
    ),
    "wrong picture": (
        computer(NEW, error=0.25),
        Code.GPU_DIFFERS,
        InputError,
        r"with an error of 2\.5e-01",
    ),
    "no number": (computer(NEW, error=float("nan")), Code.GPU_DIFFERS, InputError, "otherwise than the CPU does"),
}


@pytest.mark.parametrize(("probe", "code", "kind", "sentence"), LACKS.values(), ids=LACKS)
def test_what_is_lacking_is_one_sentence_and_the_cpu_goes_on(probe, code, kind, sentence):
    found = place("auto", 4000, probe)
    assert (found.backend, found.device) == ("cpu", "cpu")
    (note,) = found.notes
    assert note.code is code
    assert note.sentence.endswith(": the CPU renders.")


@pytest.mark.parametrize(("probe", "code", "kind", "sentence"), LACKS.values(), ids=LACKS)
def test_what_is_lacking_of_a_device_that_was_asked_for_is_an_error(probe, code, kind, sentence):
    with pytest.raises(kind, match=sentence) as raised:
        place("cuda", 4000, probe)
    assert raised.value.problem.startswith("--device cuda: ")
    assert "CPU renders" not in str(raised.value)
    assert raised.value.remedy == code.remedy.rstrip(".")


def test_a_card_that_fails_says_why():
    def fails(device):
        raise RuntimeError(f"CUDA error 700: illegal access on {device}\nand more")

    probe = CudaProbe(lambda: True, computer(NEW).cuda, fails)
    (note,) = place("auto", 4000, probe).notes
    assert note.code is Code.GPU_FAILS
    assert "(CUDA error 700: illegal access on cuda:0)" in note.sentence
    with pytest.raises(InputError, match="illegal access"):
        place("cuda:0", 4000, probe)


def test_a_named_card_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(InputError, match=r"no cuda:4 \(found: cuda:0, cuda:1\)"):
        place("cuda:4", 1, computer(NEW, SECOND))


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:x", "", "CUDA:0", "cpu:0"])
def test_a_name_that_is_none_is_refused_before_anything_is_asked(name):
    with pytest.raises(InputError, match=r"allowed: auto, cpu, cuda.*gs2ci devices"):
        place(name, 1, CudaProbe(must_not_be_asked, must_not_be_asked, must_not_be_asked))


def test_another_module_that_is_missing_is_not_taken_for_the_extra():
    def lacks_something_else():
        raise ModuleNotFoundError("No module named 'antigravity2'", name="antigravity2")

    probe = CudaProbe(lambda: True, lacks_something_else, must_not_be_asked)
    for ask in (lambda: place("auto", 1, probe), lambda: compute_devices(probe)):
        with pytest.raises(ModuleNotFoundError, match="antigravity2"):
            ask()


def test_all_devices_are_listed_with_what_they_lack():
    (cpu, old, second) = compute_devices(computer(OLD, SECOND))
    assert cpu[0] == "cpu"
    assert old[0] == "cuda:0"
    assert "compute capability 6.1, 8000 of 8192 MiB free" in old[1]
    assert "7.5 is needed" in old[1]
    assert second == ("cuda:1", "NVIDIA GeForce RTX 4090, compute capability 8.9, 24000 of 24564 MiB free")


def test_a_list_says_what_keeps_all_cards_from_being_used():
    assert [name for name, _ in compute_devices(computer(has_driver=False))] == ["cpu"]
    assert "CUDA 13.0 is needed" in compute_devices(computer(driver=(12, 2)))[1][1]
    lacking = compute_devices(CudaProbe(lambda: True, lacks_the_extra, must_not_be_asked))
    assert "pip install 'gs2ci[gpu]'" in lacking[1][1]


def test_a_look_at_two_files_tells_that_there_is_no_driver(tmp_path, monkeypatch):
    monkeypatch.setattr(devices, "_DRIVER", (tmp_path / "nvidiactl", tmp_path / "libcuda.so.1"))
    assert not CudaProbe().has_driver()
    (tmp_path / "libcuda.so.1").touch()
    assert CudaProbe().has_driver()


def test_only_the_renderer_of_cards_takes_a_device():
    with pytest.raises(InputError, match=r"no rendering backend 'cpu:cuda:0'.*warp:cuda:1"):
        load_backend("cpu:cuda:0")
