"""Pictures as a laboratory has them: a frame of the camera, and the masks as they were sent to the modulator."""

import struct

import cv2
import numpy as np
import pytest
import tifffile

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.opening import open_foreign
from gs2ci.core.foreign.options import ImportOptions


@pytest.fixture
def laboratory(tmp_path, scene):
    """A 16-bit frame and twelve masks of 0 and 255, whose names sort wrongly as texts; and what they show."""
    made = scene(n=12, channels=1)
    frame = np.rint(made.meas[..., 0] * 4095).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "frame.tif"), frame)
    masks = tmp_path / "Masken für DMD"
    masks.mkdir()
    for i, mask in enumerate(made.masks):
        (masks / f"mask{i}.png").write_bytes(cv2.imencode(".png", mask * 255)[1])
    (masks / "notes.txt").write_text("order of exposure")
    (masks / ".hidden.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    return tmp_path / "frame.tif", masks, made


def test_a_frame_and_a_folder_of_masks_are_a_measurement_in_the_order_of_their_numbers(laboratory, said):
    frame, folder, made = laboratory
    imported = import_shots(frame, folder, ImportOptions(scale=4095.0))
    (shot,) = imported.shots
    assert np.array_equal(shot.masks, made.masks)
    assert np.abs(shot.measurement - made.meas).max() < 1 / 4095
    assert said(imported, f"{folder}: 12 pictures, mask0.png to mask11.png")


@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"GIF89a"])
@pytest.mark.parametrize("name", ["mask3.png", "mask3.PNG"])
def test_a_mask_that_is_no_picture_is_not_passed_over(laboratory, name, content):
    """The masks after it would otherwise be taken for those before them."""
    frame, folder, _ = laboratory
    (folder / "mask3.png").unlink()
    (folder / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"{name}: no picture, though its name ends as theirs do"):
        import_shots(frame, folder, ImportOptions(scale=4095.0))


def test_the_pages_of_a_tiff_are_masks(laboratory, tmp_path):
    frame, _, made = laboratory
    cv2.imwritemulti(str(tmp_path / "masks.tif"), [mask * 255 for mask in made.masks])
    assert np.array_equal(import_shots(frame, tmp_path / "masks.tif", ImportOptions()).shots[0].masks, made.masks)


@pytest.mark.parametrize(
    ("ending", "dtype"),
    [(".bmp", np.uint8)]
    + [(ending, dtype) for ending in (".png", ".pgm", ".tif") for dtype in (np.uint8, np.uint16)]
    + [(".tif", np.float32)],
)
def test_numbers_stay_as_they_are_stored(tmp_path, dtype, ending):
    picture = (np.arange(6 * 8).reshape(6, 8) * 5).astype(dtype)
    cv2.imwrite(str(tmp_path / f"a{ending}"), picture)
    values = open_foreign(tmp_path / f"a{ending}").load("").values
    assert values.dtype == dtype
    assert np.array_equal(values, picture)


def test_colours_stand_in_their_order_and_grey_saved_as_colour_is_grey(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (6, 8, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), picture[..., ::-1])
    assert np.array_equal(open_foreign(tmp_path / "a.png").load("").values, picture)
    grey = np.repeat(picture[..., :1], 3, axis=2)
    cv2.imwrite(str(tmp_path / "b.png"), np.dstack([grey, np.full((6, 8), 255, np.uint8)]))
    assert np.array_equal(open_foreign(tmp_path / "b.png").load("").values, picture[..., 0])


def test_a_folder_of_one_picture_is_one_mask(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.ones((6, 8), np.uint8))
    assert open_foreign(tmp_path).entries[""].shape == (1, 6, 8)


def test_a_jpeg_is_refused_because_its_numbers_are_no_light(tmp_path):
    cv2.imwrite(str(tmp_path / "a.jpg"), np.ones((6, 8), np.uint8))
    for path in (tmp_path / "a.jpg", tmp_path):
        with pytest.raises(InputError, match=r"a JPEG, .*proportional to light.*16-bit PNG or TIFF"):
            open_foreign(path)


def test_pictures_that_do_not_go_together_are_refused_by_name(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.ones((6, 8), np.uint8))
    for odd in (np.ones((6, 9), np.uint8), np.ones((6, 8), np.uint16)):
        cv2.imwrite(str(tmp_path / "b.png"), odd)
        with pytest.raises(InputError, match=r"b\.png: 6 x .* pixels of .*, but a\.png has 6 x 8 pixels of uint8"):
            open_foreign(tmp_path)


@pytest.mark.parametrize("odd", [np.ones((6, 9), np.uint8), np.ones((6, 8), np.uint16)])
@pytest.mark.parametrize("place", [1, 2])
def test_pages_of_one_file_that_do_not_go_together_are_refused_by_number(tmp_path, odd, place):
    pages = [np.ones((6, 8), np.uint8)] * 3
    pages[place] = odd
    cv2.imwritemulti(str(tmp_path / "m.tif"), pages)
    with pytest.raises(InputError, match=rf"m\.tif, page {place + 1}: 6 x .*, but m\.tif has 6 x 8 pixels of uint8"):
        open_foreign(tmp_path / "m.tif")


def test_reduced_copies_among_the_pages_are_left_out(tmp_path):
    """A first page of another size was refused; a camera's raw file has no other in its list, and that one was read."""
    masks = (np.random.default_rng(0).random((3, 16, 24)) < 0.5) * np.uint8(255)
    with tifffile.TiffWriter(tmp_path / "stack.tif") as file:
        file.write(masks[0, ::4, ::4], subfiletype=1)
        for mask in masks:
            file.write(mask, photometric="minisblack")
    found = open_foreign(tmp_path / "stack.tif")
    assert np.array_equal(found.load("").values, masks)
    assert "1 reduced copies among its pages: left out" in found.note
    with tifffile.TiffWriter(tmp_path / "raw.nef") as file:
        file.write(masks[0, ::4, ::4], subfiletype=1, subifds=1)
        file.write(masks[0].astype(np.uint16), photometric=32803)
    with pytest.raises(InputError, match=r"another raw file of a camera.*dcraw"):
        open_foreign(tmp_path / "raw.nef")


def tiff(pages, order, *, big, pictures_first):
    """Write 8-bit pages as a TIFF, each followed by its directory, or all of them before the first directory."""
    link, count = (order + "Q", order + "Q") if big else (order + "I", order + "H")
    mark = b"II" if order == "<" else b"MM"
    stored = bytearray(mark + (struct.pack(order + "HHH", 43, 8, 0) if big else struct.pack(order + "H", 42)))
    at = len(stored)
    stored += struct.pack(link, 0)
    places = {}
    for k in range(len(pages)) if pictures_first else ():
        places[k] = len(stored)
        stored += pages[k].tobytes()
    for k, page in enumerate(pages):
        if k not in places:
            places[k] = len(stored)
            stored += page.tobytes()
        stored[at : at + struct.calcsize(link)] = struct.pack(link, len(stored))
        height, width = page.shape
        # Width, length, bits, compression, photometric interpretation, strip, samples, rows per strip, bytes of it.
        tags = {256: width, 257: height, 258: 8, 259: 1, 262: 1, 273: places[k], 277: 1, 278: height, 279: page.nbytes}
        stored += struct.pack(count, len(tags))
        for tag, value in tags.items():
            stored += struct.pack(order + "HH" + 2 * link[1], tag, 16 if big else 4, 1, value)
        at = len(stored)
        stored += struct.pack(link, 0)
    return bytes(stored)


@pytest.mark.parametrize("pictures_first", [False, True])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_tiff_that_was_cut_anywhere_is_refused(tmp_path, order, big, pictures_first):
    """Nowhere may the pages before the cut be taken for all of them."""
    pages = list(np.random.default_rng(0).integers(0, 256, (3, 6, 8), np.uint8))
    whole = tiff(pages, order, big=big, pictures_first=pictures_first)
    path = tmp_path / "m.tif"
    path.write_bytes(whole)
    assert np.array_equal(open_foreign(path).load("").values, pages)
    counted = False
    for kept in (*range(16, len(whole), 5), len(whole) - 1):
        path.write_bytes(whole[:kept])
        with pytest.raises(InputError, match=r"m\.tif: (no picture|cannot be read|\d page)") as refused:
            open_foreign(path)
        counted |= "2 page(s) can be read, but its list of pages does not end there" in refused.value.problem
    assert counted


ODD_LAYOUTS = {
    "planes": {"photometric": "rgb", "planarconfig": "separate"},
    "tiled planes": {"photometric": "rgb", "planarconfig": "separate", "tile": (16, 16)},
    "from white": {"photometric": "miniswhite"},
}


@pytest.mark.parametrize("form", [{}, {"bigtiff": True}, {"byteorder": ">"}])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.float32, np.float64])
@pytest.mark.parametrize("layout", ODD_LAYOUTS)
def test_numbers_that_opencv_mixes_up_are_refused(tmp_path, layout, dtype, form):
    """Of more than 8 bits it reads planes as if colours lay side by side, and forgets that 0 is white."""
    colours = np.random.default_rng(0).integers(0, 120, (3, 24, 32)).astype(dtype)
    planes = "planes" in layout
    for pages in (1, 2):
        one = colours if planes else colours[0]
        tifffile.imwrite(
            tmp_path / "a.tif", np.stack([one] * pages)[0 if pages == 1 else ...], **ODD_LAYOUTS[layout], **form
        )
        if dtype == np.uint8 and layout != "tiled planes":
            values = open_foreign(tmp_path / "a.tif").load("").values
            assert np.array_equal(
                values if pages == 1 else values[1], np.moveaxis(colours, 0, 2) if planes else 255 - one
            )
        else:
            with pytest.raises(
                InputError, match="separate planes.*side by side|no picture" if planes else "counts from white"
            ):
                open_foreign(tmp_path / "a.tif")
    if planes:  # the remedies
        tifffile.imwrite(tmp_path / "a.tif", np.moveaxis(colours, 0, 2), photometric="rgb", **form)
        assert np.array_equal(open_foreign(tmp_path / "a.tif").load("").values, np.moveaxis(colours, 0, 2))
        tifffile.imwrite(tmp_path / "a.tif", colours, photometric="minisblack", **form)
        assert np.array_equal(open_foreign(tmp_path / "a.tif").load("").values, colours)


@pytest.mark.parametrize("pages", [1, 4])
@pytest.mark.parametrize("form", [{}, {"byteorder": ">"}, {"compression": "zlib"}, {"photometric": "minisblack"}])
def test_boolean_masks_of_tifffile_are_open_where_they_are_true(tmp_path, form, pages):
    """tifffile 2026.3.3 writes them with the tag of pictures whose 0 is white, and itself passes over it."""
    masks = np.random.default_rng(0).random((pages, 20, 24)) < 0.3
    tifffile.imwrite(tmp_path / "a.tif", masks if pages > 1 else masks[0], **form)
    container = open_foreign(tmp_path / "a.tif")
    assert np.array_equal(container.load("").values > 0, masks if pages > 1 else masks[0])
    assert ("true is 1" in container.note) == ("photometric" not in form)


@pytest.mark.parametrize(("dtype", "absent"), [(np.float32, "-9999"), (np.uint16, "65535"), (np.float32, "-3.4e+38")])
def test_a_number_that_gdal_writes_where_there_is_none_is_no_reading(laboratory, tmp_path, said, dtype, absent):
    # As rasterio 1.4.4 writes them with nodata=; the readings around are as without the tag.
    _, folder, made = laboratory
    frame = np.rint(made.meas[..., 0] * 4095).astype(dtype)
    frame[5, 7] = dtype(absent)
    path = tmp_path / "gdal.tif"
    tifffile.imwrite(path, frame, extratags=[(42113, "s", 0, absent, True)])
    with pytest.raises(InputError, match=r"1 pixels are NaN.*row 5, column 7"):
        import_shots(path, folder, ImportOptions(scale=4095.0))
    imported = import_shots(path, folder, ImportOptions(scale=4095.0, bad_pixels="median"))
    others = np.ones(frame.shape, bool)
    others[5, 7] = False
    assert np.abs(imported.shots[0].measurement - made.meas)[others].max() < 1 / 4095
    assert said(imported, "stands where there is no number")


def test_zeros_that_gdal_calls_no_data_are_closed_elements(tmp_path):
    masks = np.eye(12, dtype=np.uint8) * 255
    tifffile.imwrite(tmp_path / "masks.tif", masks, extratags=[(42113, "s", 0, "0", True)])
    assert np.array_equal(open_foreign(tmp_path / "masks.tif").load("").values, masks)


@pytest.mark.parametrize("planes", ["contig", "separate"])
def test_bands_of_one_page_are_refused_with_the_way_out(tmp_path, planes):
    shape = (12, 20, 5) if planes == "contig" else (5, 12, 20)
    values = np.zeros(shape, np.uint16)
    tifffile.imwrite(tmp_path / "bands.tif", values, photometric="minisblack", planarconfig=planes)
    with pytest.raises(InputError, match=r"5 numbers for each pixel.*as pages"):
        open_foreign(tmp_path / "bands.tif")


def test_a_tiff_of_another_program_that_counts_from_white_is_said_to(tmp_path):
    mask = np.random.default_rng(0).random((6, 8)) < 0.5
    tifffile.imwrite(tmp_path / "mask.tif", np.stack([mask, ~mask]), metadata=None, description="a scan")
    container = open_foreign(tmp_path / "mask.tif")
    assert np.array_equal(container.load("").values[0], 255 * ~mask)
    assert container.note == "0 is white, as its tag says"


def test_a_tiff_whose_directories_lead_in_a_circle_is_no_endless_one(tmp_path):
    pages = list(np.random.default_rng(0).integers(0, 256, (2, 6, 8), np.uint8))
    whole = tiff(pages, "<", big=False, pictures_first=True)
    (first,) = struct.unpack_from("<I", whole, 4)
    (tmp_path / "m.tif").write_bytes(whole[:-4] + struct.pack("<I", first))
    assert np.array_equal(open_foreign(tmp_path / "m.tif").load("").values, pages)


def test_names_with_digits_of_other_kinds_are_names(tmp_path):
    """Superscripts are digits, but no decimal ones: no number can be made of them."""
    for name in ("m1²0.png", "m1²1.png", "m²10.png", "m²9.png"):
        (tmp_path / name).write_bytes(cv2.imencode(".png", np.ones((6, 8), np.uint8))[1])
    assert open_foreign(tmp_path).note == "4 pictures, m1²0.png to m²10.png"


@pytest.mark.parametrize(
    ("names", "doubted"),
    [
        (("t0.5", "t1.0", "t1.5"), False),
        (("t0.5", "t0.25", "t0.75"), True),
        (("mask 9", "mask 10"), False),
        (("mask1", "mask01a"), False),
        (("2026.11.28-9", "2026.11.28-10"), False),
        (("v1.9", "v1.10"), True),
    ],
)
def test_names_whose_decimal_numbers_would_give_another_order_are_doubted(tmp_path, names, doubted):
    for name in names:
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.ones((6, 8), np.uint8))
    note = open_foreign(tmp_path).note
    assert note.startswith(f"{len(names)} pictures, ")
    assert ("0.5 before 0.25" in note) == doubted


def test_a_picture_that_is_partly_transparent_is_refused(tmp_path):
    picture = np.full((6, 8, 4), 255, np.uint8)
    picture[0, 0, 3] = 0
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    with pytest.raises(InputError, match=r"partly transparent.*four masks page by page"):
        open_foreign(tmp_path / "a.png")


def test_too_many_pictures_are_refused_before_they_fill_the_memory(tmp_path, monkeypatch):
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), np.ones((6, 8), np.uint8))
    monkeypatch.setattr("gs2ci.core.foreign.pictures.LIMIT_BYTES", 90)
    with pytest.raises(InputError, match="more than 90 bytes"):
        open_foreign(tmp_path)


def test_a_measurement_among_its_masks_is_no_mask(tmp_path):
    """It was taken for one, and left a better trace than all the others."""
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((3, 4), k, np.uint8))
    assert open_foreign(tmp_path).load("").values.shape == (4, 3, 4)
    cv2.imwrite(str(tmp_path / "snapshot.png"), np.full((3, 4), 9, np.uint8))
    with pytest.raises(
        InputError, match=r"snapshot\.png beside 4 pictures whose names.*what to do: take snapshot\.png"
    ):
        open_foreign(tmp_path)


def test_names_without_numbers_are_doubted(tmp_path):
    for name in ("one", "two", "three"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((3, 4), len(name), np.uint8))
    assert "one.png to two.png; WARNING: in the order of the alphabet" in open_foreign(tmp_path).note


def test_a_folder_of_other_files_names_one(tmp_path):
    np.save(tmp_path / "mask0.npy", np.ones((3, 4)))
    with pytest.raises(InputError, match=r"it holds 1 files, such as mask0\.npy.*np\.stack"):
        open_foreign(tmp_path)


def test_a_folder_without_pictures_and_a_damaged_picture_are_named(tmp_path, capfd):
    with pytest.raises(InputError, match=r"no picture in this folder; allowed: PNG, TIFF"):
        open_foreign(tmp_path)
    whole = cv2.imencode(".png", np.random.default_rng(0).integers(0, 255, (60, 80), np.uint8))[1].tobytes()
    for content in (whole[:40], whole[:3000], b"II*\0" + bytes(20), b"P5 broken", b"BM"):
        (tmp_path / "a.png").write_bytes(content)
        with pytest.raises(InputError, match=r"a\.png: (no picture can be read in it|cannot be read)"):
            open_foreign(tmp_path / "a.png")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("colours", [False, True])
@pytest.mark.parametrize("form", [{"imagej": True}, {"metadata": {"axes": "ZYX"}}, {}])
def test_a_stack_that_lists_one_page_for_many_is_refused(tmp_path, form, colours):
    pages = np.random.default_rng(0).integers(0, 255, (4, 6, 8, 3) if colours else (4, 6, 8)).astype(np.uint8)
    form = form | {"photometric": "rgb" if colours else "minisblack"}
    if colours and "metadata" in form:
        form["metadata"] = {"axes": "ZYXS"}
    path = tmp_path / "m.tif"
    tifffile.imwrite(path, pages, **form)
    assert np.array_equal(open_foreign(path).load("").values, pages)
    tifffile.imwrite(path, pages, truncate=True, **form)
    with pytest.raises(InputError, match=r"m\.tif: its description counts 4 images, but its list has 1 page.*folder"):
        open_foreign(path)
    tifffile.imwrite(path, pages[0], **({} if "metadata" in form else form))
    assert open_foreign(path).load("").values.shape == pages[0].shape


def test_masks_that_are_named_by_positions_come_in_their_order(laboratory, tmp_path, said):
    """F6: order 4 5 6 7 3 2 1 0, silent."""
    frame, folder, made = laboratory
    for i in range(12):
        (folder / f"mask{i}.png").rename(folder / f"z_{i - 6}mm.png")
    imported = import_shots(frame, folder, ImportOptions(scale=4095.0))
    assert np.array_equal(imported.shots[0].masks, made.masks)
    assert said(imported, "12 pictures, z_-6mm.png to z_5mm.png")


def test_three_pictures_of_a_folder_are_three_measurements(tmp_path, scene):
    """They became the colours of one."""
    made = scene(height=32, width=40)
    (tmp_path / "shots").mkdir()
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"shots/shot_{k}.png"), np.rint(600 * made.meas[..., k]).astype(np.uint16))
    np.save(tmp_path / "masks.npy", made.masks)
    imported = import_shots(tmp_path / "shots", tmp_path / "masks.npy", ImportOptions(scale=600.0))
    assert [shot.measurement.shape for shot in imported.shots] == [(32, 40, 1)] * 3
    for k, shot in enumerate(imported.shots):
        assert np.abs(shot.measurement[..., 0] - made.meas[..., k]).max() < 1e-3
    assert any("say --meas-layout rgb" in guess for guess in imported.guesses)
    coloured = ImportOptions(scale=600.0, meas_layout="rgb")
    assert import_shots(tmp_path / "shots", tmp_path / "masks.npy", coloured).shots[0].measurement.shape == (32, 40, 3)
