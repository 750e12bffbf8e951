"""Methods of the literature as lines of tables."""

from dataclasses import asdict

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.learned.ffdnet import export_ffdnet, read_ffdnet
from gs2ci.reconstruct.learned.onnx_models import add_model
from tests.tables.cases import Case
from tests.tables.catalogue import TABLES, TableOptions
from tests.tables.columns import RECONSTRUCTION
from tests.tables.literature import DECODERS, LEARNED, decode_case, field_case, model_files

TINY = Case("boxes", scene="boxes", size=(24, 32), views=4)


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    return tmp_path


@pytest.fixture
def ffdnet(home):
    """A denoiser that gives each block of four pixels their mean, added under its name."""
    first, last = torch.zeros(4, 5, 3, 3), torch.zeros(4, 4, 3, 3)
    first[:, :4, 1, 1] = 0.25
    last[range(4), range(4), 1, 1] = 1
    torch.save({"0.weight": first, "2.weight": last}, home / "weights.pth")
    path = export_ffdnet(read_ffdnet(home / "weights.pth"), home / "ffdnet.onnx")
    add_model("ffdnet", path)
    return path


@pytest.mark.parametrize("method", ["gap-tv", "gap-tv, coupled", "pnp-tv", "patches-quick"])
def test_a_decoder_is_scored_by_its_views_alone(method):
    row = decode_case(asdict(TINY), method, 0)
    assert row["psnr_db"] > 10
    assert 0 < row["ssim"] < 1
    assert row["seconds"] > 0
    assert row.keys() <= {measure.key for measure in RECONSTRUCTION}


def test_an_unknown_decoder_is_refused_with_those_that_there_are():
    with pytest.raises(InputError, match="decoder 'x'") as caught:
        decode_case(asdict(TINY), "x", 0)
    assert {"gap-tv", "pnp-ffdnet"} <= set(caught.value.allowed.split(", "))


@pytest.mark.usefixtures("home")
def test_a_line_without_its_model_says_how_to_add_one():
    with pytest.raises(InputError, match="no ffdnet-colour model") as caught:
        decode_case(asdict(TINY), "pnp-ffdnet-colour", 0)
    assert "models add ffdnet-colour" in caught.value.remedy
    assert model_files("pnp-ffdnet-colour") == model_files("gap-tv") == ()


def test_a_line_with_a_model_depends_on_its_file(ffdnet):
    options = TableOptions((TINY,), seeds=1, lines=("pnp-ffdnet",))
    (entry,) = TABLES["literature"].entries(options)
    assert entry.cell.files == (str(ffdnet.resolve()),)
    assert decode_case(**entry.cell.arguments)["psnr_db"] > 10


def test_slow_lines_and_those_with_weights_are_made_where_they_are_named():
    entries = TABLES["literature"].entries(TableOptions((TINY,), seeds=1))
    assert [entry.line for entry in entries] == ["default", *DECODERS]
    slow = ("scisplat", "field", *LEARNED)
    entries = TABLES["literature"].entries(TableOptions((TINY,), seeds=2, lines=slow))
    assert [entry.line for entry in entries] == [line for line in slow for _ in range(2)]
    assert len({entry.cell.key for entry in entries}) == len(entries)


def test_a_field_is_scored_as_a_scene_is():
    row = field_case(asdict(TINY), 5, 0)
    assert {measure.key for measure in RECONSTRUCTION} <= row.keys()
    assert row["scene_psnr_db"] == row["psnr_db"] > 5
    assert all(np.isfinite(row[key]) for key in ("between_psnr_db", "beyond_psnr_db", "nate", "depth_rel_percent"))
