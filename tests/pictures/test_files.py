"""Pictures: reading every kind, refusing the unusable with one line, and finding frames."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.pictures.files import LAST_STAGE, STAGE_SHEET, find_frames, path_in_folder, read_image, write_image
from circlecal.pictures.headers import read_header

HEIGHT, WIDTH = 72, 96


def picture(channels: int = 3, dtype: type = np.uint8) -> np.ndarray:
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    planes = np.stack([x * 2, y * 3, 255 - x * 2, np.full_like(x, 255)], axis=-1)[..., :channels]
    return (planes * (257 if dtype == np.uint16 else 1)).astype(dtype).squeeze()


def encoded(suffix: str = ".jpg", image: np.ndarray | None = None) -> bytes:
    return cv2.imencode(suffix, picture() if image is None else image)[1].tobytes()


def with_orientation(jpeg: bytes, orientation: int) -> bytes:
    exif = b"Exif\0\0" + b"II*\0\x08\0\0\0" + struct.pack("<HHHIHH", 1, 0x0112, 3, 1, orientation, 0) + b"\0" * 4
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]


def problem(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_image(path)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def touched(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".bmp", ".tiff", ".webp"])
def test_every_format_is_read_as_bgr(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(encoded(suffix))
    image = read_image(path)
    assert image.dtype == np.uint8
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(image.astype(int) - picture()).mean() < 12
    header = read_header(path.read_bytes())
    assert (header.width, header.height, header.truncated) == (WIDTH, HEIGHT, False)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_transparent_and_16_bit_pictures(tmp_path, channels, dtype):
    path = tmp_path / "a.png"
    path.write_bytes(encoded(".png", picture(channels, dtype)))
    wanted = np.repeat(picture(1)[:, :, None], 3, axis=2) if channels == 1 else picture(3)
    assert np.array_equal(read_image(path), wanted)


def test_12_bits_in_a_16_bit_file_use_the_whole_range(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(encoded(".png", (picture(3, np.uint16) >> 4)))
    assert read_image(path).max() >= 250


def test_exif_orientation_is_honoured(tmp_path):
    path = tmp_path / "a.jpg"
    path.write_bytes(with_orientation(encoded(".jpg"), 6))
    upright = cv2.rotate(picture(), cv2.ROTATE_90_CLOCKWISE)
    image = read_image(path)
    assert image.shape == upright.shape
    assert np.abs(image.astype(int) - upright).mean() < 12


def test_missing_folder_empty_and_text(tmp_path):
    assert "no such file" in problem(tmp_path / "none.jpg")
    assert "is a folder" in problem(tmp_path)
    empty = tmp_path / "empty.jpg"
    empty.touch()
    assert "empty" in problem(empty)
    text = tmp_path / "text.jpg"
    text.write_text("this is no picture")
    assert "no JPEG" in problem(text)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".bmp", ".tiff", ".webp"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.99])
def test_truncated_files_are_errors(tmp_path, capfd, suffix, share):
    whole = encoded(suffix)
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(whole[: max(30, int(len(whole) * share))])
    text = problem(path)
    assert "truncated" in text or "damaged" in text or "only" in text
    if suffix != ".tiff":
        assert capfd.readouterr().err == ""


def test_a_thumbnail_does_not_hide_a_truncated_jpeg(tmp_path):
    thumbnail = encoded(".jpg", np.zeros((8, 8, 3), np.uint8))
    whole = encoded(".jpg")
    exif = b"Exif\0\0" + thumbnail
    path = tmp_path / "a.jpg"
    path.write_bytes((whole[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + whole[2:])[:-40])
    assert "truncated" in problem(path)


@pytest.mark.parametrize("size", [(1, 1), (40, 200), (200, 40)])
def test_too_small(tmp_path, size):
    path = tmp_path / "small.png"
    path.write_bytes(encoded(".png", np.zeros((*size, 3), np.uint8)))
    assert f"{size[1]} x {size[0]}" in problem(path)


def test_too_large_is_refused_from_the_header_alone(tmp_path):
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    path = tmp_path / "large.png"
    header = struct.pack(">IIBBBBB", 20000, 20000, 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
    assert "20000 x 20000" in problem(path)
    jpeg = bytearray(encoded(".jpg"))
    at = jpeg.index(b"\xff\xc0")
    jpeg[at + 5 : at + 9] = struct.pack(">HH", 20000, 20000)
    path = tmp_path / "large.jpg"
    path.write_bytes(bytes(jpeg))
    assert "20000 x 20000" in problem(path)


def test_floating_point_pictures_are_refused(tmp_path):
    path = tmp_path / "a.tiff"
    path.write_bytes(encoded(".tiff", picture().astype(np.float32)))
    assert "float32" in problem(path)


def test_ids_in_a_tree_are_relative_paths(tmp_path):
    touched(tmp_path / "a.jpg", tmp_path / "day1" / "a.jpg", tmp_path / "day2" / "sub" / "a.PNG")
    assert [f.id for f in find_frames([tmp_path])] == ["a", "day1__a", "day2__sub__a"]


def test_files_and_folders_alike_each_once(tmp_path):
    touched(tmp_path / "a.jpg", tmp_path / "b.jpg")
    assert [f.id for f in find_frames([tmp_path / "b.jpg", tmp_path])] == ["b", "a"]


def test_masks_hidden_files_and_own_pictures_are_no_frames(tmp_path):
    touched(
        tmp_path / "a.jpg",
        tmp_path / "a.mask.png",
        tmp_path / "masks" / "a.png",
        tmp_path / "._a.jpg",
        tmp_path / ".cache" / "a.jpg",
        tmp_path / "a.overlay.jpg",
        tmp_path / "a.radar.jpg",
        tmp_path / "a.debug" / "01-mask.jpg",
        tmp_path / "circlecal-out" / "a.overlay.jpg",
        tmp_path / "notes.txt",
        tmp_path / "given" / "a.png",
    )
    frames = find_frames([tmp_path], exclude=[tmp_path / "given"])
    assert [f.path.name for f in frames] == ["a.jpg"]


def test_pictures_of_stages_are_no_frames_whatever_their_folder_is_called(tmp_path):
    touched(tmp_path / "a.jpg", *(tmp_path / "mine" / "a" / f"{n}.jpg" for n in ("01-mask", LAST_STAGE, STAGE_SHEET)))
    assert [f.id for f in find_frames([tmp_path])] == ["a"]


def test_links_to_folders_are_followed_but_not_in_a_circle(tmp_path):
    touched(tmp_path / "store" / "b.jpg", tmp_path / "given" / "day" / "a.jpg")
    (tmp_path / "given" / "linked").symlink_to(tmp_path / "store")
    (tmp_path / "given" / "day" / "up").symlink_to(tmp_path / "given")
    assert [f.id for f in find_frames([tmp_path / "given"])] == ["day__a", "linked__b"]


def test_the_path_of_a_picture_in_its_folder_is_told_by_its_id(tmp_path):
    touched(tmp_path / "s" / "t.jpg", tmp_path / "a__b.jpg", tmp_path / "s" / "a__b.jpg", tmp_path / "v.png")
    for frame in find_frames([tmp_path]):
        assert path_in_folder(frame.id, frame.path) == frame.mask_stem
    assert path_in_folder("t-jpg", tmp_path / "s" / "t.jpg") == "t"


def test_masks_given_by_a_shell_pattern_are_no_frames(tmp_path):
    touched(tmp_path / "a.jpg", tmp_path / "a.mask.png", tmp_path / "masks" / "a.png")
    given = [tmp_path / "a.jpg", tmp_path / "a.mask.png", tmp_path / "masks"]
    assert [f.id for f in find_frames(given)] == ["a"]
    with pytest.raises(InputError, match="only masks"):
        find_frames([tmp_path / "a.mask.png"])


def test_a_folder_called_masks_without_pictures_beside_holds_frames(tmp_path):
    touched(tmp_path / "masks" / "a.jpg")
    assert [f.id for f in find_frames([tmp_path / "masks"])] == ["a"]


def test_equal_names_get_different_ids(tmp_path):
    touched(
        tmp_path / "one" / "a.jpg", tmp_path / "one" / "a.png", tmp_path / "two" / "a.jpg", tmp_path / "two" / "b.jpg"
    )
    ids = [f.id for f in find_frames([tmp_path / "one", tmp_path / "two"])]
    assert ids == ["one__a-jpg", "a-png", "two__a-jpg", "b"]
    assert ids == [f.id for f in find_frames([tmp_path / "one", tmp_path / "two"])]
    touched(tmp_path / "tree" / "x__y.jpg", tmp_path / "tree" / "x" / "y.jpg", tmp_path / "tree" / "X__Y.png")
    ids = [f.id for f in find_frames([tmp_path / "tree"])]
    assert len({i.casefold() for i in ids}) == 3


def test_nothing_to_calibrate(tmp_path):
    with pytest.raises(InputError, match="no pictures"):
        find_frames([tmp_path])
    with pytest.raises(InputError, match="no such file"):
        find_frames([tmp_path / "none"])


def test_an_unreadable_folder(tmp_path, monkeypatch):
    def refuse(self: Path) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(InputError, match="cannot be read: Permission denied"):
        find_frames([tmp_path])


def test_write_image_leaves_nothing_behind_when_it_fails(tmp_path, monkeypatch):
    path = tmp_path / "a.jpg"
    write_image(path, picture(), 80)
    before = path.read_bytes()
    monkeypatch.setattr("os.fsync", lambda descriptor: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(InputError, match="No space left"):
        write_image(path, picture(), 10)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.jpg"]


def test_writing_below_a_file_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        write_image(tmp_path / "file" / "a.jpg", picture())
