"""Masks: every encoding to class ids, and the ones that are none."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.pictures.files import PictureFile
from circlecal.pictures.masks import PALETTE_RGB, as_class_ids, find_mask, read_mask
from circlecal.results import CIRCLE_ID

HEIGHT, WIDTH = 90, 160


def class_ids() -> np.ndarray:
    ids = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.ellipse(ids, (80, 45), (60, 25), 0, 0, 360, 7, 2)
    cv2.line(ids, (80, 5), (80, 85), 18, 2)
    ids[80:82] = 19
    return ids


def circle() -> np.ndarray:
    return class_ids() == 7


def colours(ids: np.ndarray) -> np.ndarray:
    rgb = np.zeros((*ids.shape, 3), np.uint8)
    for colour, number in PALETTE_RGB.items():
        rgb[ids == number] = colour
    return rgb


def stored(folder, image):
    path = folder / "mask.png"
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return path


def palette_png(ids: np.ndarray) -> bytes:
    """A PNG with a palette, which OpenCV cannot write."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    table = np.zeros((29, 3), np.uint8)
    for colour, number in PALETTE_RGB.items():
        table[number] = colour
    rows = b"".join(b"\0" + row.tobytes() for row in ids)
    header = struct.pack(">IIBBBBB", ids.shape[1], ids.shape[0], 8, 3, 0, 0, 0)
    parts = (
        chunk(b"IHDR", header),
        chunk(b"PLTE", table.tobytes()),
        chunk(b"IDAT", zlib.compress(rows)),
        chunk(b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def problem(path) -> str:
    with pytest.raises(InputError) as caught:
        read_mask(path, WIDTH, HEIGHT)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    return text


@pytest.mark.parametrize("value", [1, 7, 128, 255])
def test_binary_masks_are_the_circle(tmp_path, value):
    path = stored(tmp_path, circle().astype(np.uint8) * value)
    assert np.array_equal(read_mask(path, WIDTH, HEIGHT), np.where(circle(), CIRCLE_ID, 0))


@pytest.mark.parametrize("value", [1, 255, 65535])
def test_16_bit_binary_masks(tmp_path, value):
    path = stored(tmp_path, circle().astype(np.uint16) * value)
    assert np.array_equal(read_mask(path, WIDTH, HEIGHT), np.where(circle(), CIRCLE_ID, 0))


def test_binary_masks_with_soft_edges_or_from_jpeg(tmp_path):
    soft = cv2.GaussianBlur(circle().astype(np.uint8) * 255, (0, 0), 0.3)
    jpeg = tmp_path / "mask.jpg"
    jpeg.write_bytes(cv2.imencode(".jpg", circle().astype(np.uint8) * 255, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes())
    for path in (stored(tmp_path, soft), jpeg):
        assert np.count_nonzero((read_mask(path, WIDTH, HEIGHT) > 0) != circle()) < 0.1 * circle().sum()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_single_channel_class_ids(tmp_path, dtype):
    assert np.array_equal(read_mask(stored(tmp_path, class_ids().astype(dtype)), WIDTH, HEIGHT), class_ids())


def test_palette_colours(tmp_path):
    path = stored(tmp_path, colours(class_ids())[:, :, ::-1])
    assert np.array_equal(read_mask(path, WIDTH, HEIGHT), class_ids())


def test_png_with_a_palette(tmp_path):
    path = tmp_path / "mask.png"
    path.write_bytes(palette_png(class_ids()))
    assert np.array_equal(read_mask(path, WIDTH, HEIGHT), class_ids())


def test_class_27_has_two_colours(tmp_path):
    for grey in (128, 255):
        bgr = colours(class_ids())[:, :, ::-1].copy()
        bgr[class_ids() == 19] = grey
        ids = read_mask(stored(tmp_path, bgr), WIDTH, HEIGHT)
        assert np.array_equal(ids == 27, class_ids() == 19)


def test_white_on_black_in_three_or_four_channels_is_binary(tmp_path):
    white = np.repeat(circle().astype(np.uint8)[:, :, None] * 255, 3, axis=2)
    clear = np.dstack([np.full_like(white, 255), circle().astype(np.uint8) * 255])
    for image in (white, clear):
        assert np.array_equal(read_mask(stored(tmp_path, image), WIDTH, HEIGHT), np.where(circle(), CIRCLE_ID, 0))


def test_class_ids_in_three_equal_channels(tmp_path):
    path = stored(tmp_path, np.repeat(class_ids()[:, :, None], 3, axis=2))
    assert np.array_equal(read_mask(path, WIDTH, HEIGHT), class_ids())


def test_another_size_is_rescaled_without_new_values(tmp_path):
    ids = read_mask(stored(tmp_path, class_ids()), 1920, 1080)
    assert ids.shape == (1080, 1920)
    assert set(np.unique(ids)) == set(np.unique(class_ids()))
    assert np.array_equal(ids[6::12, 6::12], class_ids())


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_all_black_is_empty_and_all_white_is_an_error(tmp_path, channels):
    black = np.zeros((HEIGHT, WIDTH, channels), np.uint8)
    white = np.full_like(black, 255)
    assert not read_mask(stored(tmp_path, black), WIDTH, HEIGHT).any()
    assert "all white" in problem(stored(tmp_path, white))


def test_colours_of_16_bit_with_values_of_8():
    mask = np.zeros((HEIGHT, WIDTH, 3), np.uint16)
    mask[40:44] = 255
    assert np.array_equal(as_class_ids(mask, WIDTH, HEIGHT, "mask") > 0, mask[:, :, 0] > 0)
    assert np.array_equal(as_class_ids(mask * 257, WIDTH, HEIGHT, "mask") > 0, mask[:, :, 0] > 0)


def test_inverted(tmp_path):
    assert "inverted" in problem(stored(tmp_path, np.where(circle(), 0, 255).astype(np.uint8)))


def test_unknown_colours_are_named(tmp_path):
    bgr = colours(class_ids())[:, :, ::-1].copy()
    bgr[40:50] = (3, 2, 1)
    text = problem(stored(tmp_path, bgr))
    assert "1 colours" in text
    assert "(1, 2, 3)" in text


def test_a_photograph_is_no_mask(tmp_path):
    ramp = np.tile(np.arange(WIDTH, dtype=np.uint8), (HEIGHT, 1))
    assert "grey values up to" in problem(stored(tmp_path, ramp))


def test_missing_empty_and_truncated(tmp_path):
    assert "no such file" in problem(tmp_path / "none.png")
    path = stored(tmp_path, class_ids())
    path.write_bytes(path.read_bytes()[:-20])
    assert "truncated" in problem(path)
    path.write_bytes(b"")
    assert "empty" in problem(path)


def test_masks_beside_the_picture_are_found(tmp_path):
    frame = PictureFile("x", tmp_path / "x.jpg", "x")
    assert find_mask(frame, None) is None
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / "x.png").touch()
    assert find_mask(frame, None) == tmp_path / "masks" / "x.png"
    (tmp_path / "x.mask.png").touch()
    assert find_mask(frame, None) == tmp_path / "x.mask.png"


def test_a_mask_folder_may_mirror_the_tree_be_flat_or_use_ids(tmp_path):
    frame = PictureFile("sub__x", tmp_path / "frames" / "sub" / "x.jpg", "sub/x")
    for name in ("x.png", "sub__x.png", "sub/x.png"):
        path = tmp_path / "given" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        assert find_mask(frame, tmp_path / "given") == path


def test_a_mask_option_that_does_not_fit(tmp_path):
    frame = PictureFile("x", tmp_path / "x.jpg", "x")
    with pytest.raises(InputError, match=r"no mask for x\.jpg"):
        find_mask(frame, tmp_path)
    with pytest.raises(InputError, match="no such mask"):
        find_mask(frame, tmp_path / "none.png")


@pytest.mark.parametrize("shape", [(0, 0), (0, 160), (1, 1), (15, 160), (0, 0, 3), (1, 1, 4), (4, 4, 1)])
@pytest.mark.parametrize("dtype", [np.uint8, np.bool_, np.uint16])
def test_arrays_that_are_too_small(shape, dtype):
    with pytest.raises(InputError, match=rf"^mask: has only {shape[1]} x {shape[0]} pixels; at least 16 on each side"):
        as_class_ids(np.zeros(shape, dtype), WIDTH, HEIGHT, "mask")
