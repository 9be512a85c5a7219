"""Files of photographs and of calibrations, at which size and how upright they are read, and what is refused."""

import struct
import zlib

import cv2
import numpy as np
import photographed
import pytest

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.photographs import (
    Photograph,
    reading,
)
from elitelanes_jax.photographs.reading import read_lens

TOWN = photographed.TOWN


def test_photographs_are_upright_and_large_ones_smaller(tmp_path, monkeypatch):
    picture = photographed.photograph(TOWN)
    photographed.write(tmp_path / "plain.jpg", picture)
    content = (tmp_path / "plain.jpg").read_bytes()
    turned = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    (tmp_path / "turned.jpg").write_bytes(
        content[:2] + b"\xff\xe1" + (len(turned) + 2).to_bytes(2) + turned + content[2:]
    )
    plain = Photograph.read(tmp_path / "plain.jpg")
    upright = Photograph.read(tmp_path / "turned.jpg")
    np.testing.assert_array_equal(upright.image, np.rot90(plain.image, -1))
    monkeypatch.setattr(reading, "_MOST_READ", 800 * 640 / 3)
    small = Photograph.read(tmp_path / "plain.jpg")
    assert small.image.shape == (320, 400, 3) and small.shrunk == 2
    np.testing.assert_allclose(small.pixels_of(np.array([[100.5, 200.5]])), [[50, 100]])


def jpeg_with(stray, size=(300, 400)):
    """A grey JPEG file with some bytes after its first segment."""
    content = cv2.imencode(".jpg", np.full(size, 128, np.uint8))[1].tobytes()
    end = 4 + int.from_bytes(content[4:6])
    return content[:end] + stray + content[end:]


@pytest.mark.parametrize("stray", [b"", b"\0", b"\0\0\xff\0", b"\xff\xff", b"\xff\x01"])
def test_the_size_of_a_jpeg_is_read_as_its_decoder_reads_it(stray, tmp_path, monkeypatch):
    """Decoders skip bytes between segments: files with such bytes had no size, and were read without a limit."""
    (tmp_path / "stray.jpg").write_bytes(jpeg_with(stray))
    monkeypatch.setattr(reading, "_MOST_READ", 60_000)
    with pytest.raises(InputError, match="at least 200 pixels a side, got 200 x 150"):  # read at a half
        Photograph.read(tmp_path / "stray.jpg")
    monkeypatch.setattr(reading, "_MOST_PIXELS", 100_000)
    message = "expected at most 0.1 megapixels, got 400 x 300; save it smaller$"
    with pytest.raises(InputError, match=message):
        Photograph.read(tmp_path / "stray.jpg")


def test_a_jpeg_without_a_frame_header_is_refused(tmp_path):
    content = jpeg_with(b"")
    (tmp_path / "cut.jpg").write_bytes(content[: content.index(b"\xff\xc0")] + b"\xff\xd9")
    with pytest.raises(InputError, match="cut.jpg: expected a photograph, .* got one that cannot be read"):
        Photograph.read(tmp_path / "cut.jpg")


@pytest.mark.parametrize("damage", ["unfinished", "changed"])
def test_a_damaged_png_is_refused_without_complaints_of_the_decoder(damage, tmp_path, capfd):
    """The decoder's own lines stood before the message of a command."""
    photographed.write(tmp_path / "floor.png", photographed.photograph(TOWN))
    content = bytearray((tmp_path / "floor.png").read_bytes())
    if damage == "unfinished":
        content = content[: len(content) // 2]
    else:
        content[len(content) // 2] ^= 1
    (tmp_path / "floor.png").write_bytes(content)
    capfd.readouterr()
    with pytest.raises(InputError, match="floor.png: expected a photograph, .* got one that cannot be read"):
        Photograph.read(tmp_path / "floor.png")
    assert capfd.readouterr() == ("", "")


def test_a_png_is_turned_upright(tmp_path):
    """Its EXIF data are a part of the file beside those that hold pixels."""
    photographed.write(tmp_path / "plain.png", photographed.photograph(TOWN))
    content = (tmp_path / "plain.png").read_bytes()
    exif = b"eXIf" + b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    # The header ends at byte 33.
    part = (len(exif) - 4).to_bytes(4) + exif + zlib.crc32(exif).to_bytes(4)
    (tmp_path / "turned.png").write_bytes(content[:33] + part + content[33:])
    plain, upright = (Photograph.read(tmp_path / name).image for name in ("plain.png", "turned.png"))
    np.testing.assert_array_equal(upright, np.rot90(plain, -1))


def test_a_png_with_a_wrong_profile_of_colours_is_read_without_complaints(tmp_path, capfd):
    """The decoder warned of this part on the terminal if the file had an opacity."""
    file = tmp_path / "floor.png"
    assert cv2.imwrite(str(file), np.full((300, 300, 4), 255, np.uint8))
    content = file.read_bytes()
    profile = b"iCCP" + b"x\0\0" + zlib.compress(b"none")
    part = (len(profile) - 4).to_bytes(4) + profile + zlib.crc32(profile).to_bytes(4)
    file.write_bytes(content[:33] + part + content[33:])
    capfd.readouterr()
    assert Photograph.read(file).image.shape == (300, 300, 3)
    assert capfd.readouterr() == ("", "")


def test_a_photograph_with_transparent_pixels_is_refused(tmp_path):
    """What was erased in a picture editor was once seen again."""
    picture = np.full((300, 300, 4), 255, np.uint8)
    file = tmp_path / "floor.png"
    assert cv2.imwrite(str(file), picture)
    assert Photograph.read(file).image.shape == (300, 300, 3)
    picture[:9, :9, 3] = 0
    assert cv2.imwrite(str(file), picture)
    with pytest.raises(InputError, match="floor.png: expected a photograph without transparent pixels"):
        Photograph.read(file)


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_a_grey_photograph_with_one_transparent_grey_is_refused(depth, tmp_path):
    """OpenCV drops the grey that a file declares transparent, at every depth of its greys."""
    most = 2**depth - 1
    greys = np.full((300, 300), most)
    greys[:9, :9] = most // 2
    bits = np.unpackbits(greys.astype(">u2").view(np.uint8).reshape(300, 300, 2), axis=2)[..., 16 - depth :]
    rows = np.packbits(bits.reshape(300, -1), axis=1)
    head = struct.pack(">IIBBBBB", 300, 300, depth, 0, 0, 0, 0)
    pixels = zlib.compress(np.pad(rows, ((0, 0), (1, 0))).tobytes())

    def write(transparent):
        parts = {b"IHDR": head, b"tRNS": struct.pack(">H", transparent), b"IDAT": pixels, b"IEND": b""}
        content = b"\x89PNG\r\n\x1a\n"
        for kind, data in parts.items():
            content += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        (tmp_path / "floor.png").write_bytes(content)
        return tmp_path / "floor.png"

    with pytest.raises(InputError, match="floor.png: expected a photograph without transparent pixels"):
        Photograph.read(write(most // 2))
    if depth > 1:  # no pixel has the declared grey
        assert (Photograph.read(write(most // 2 + 1)).image[20:] == 255).all()


def test_a_calibrated_lens_is_straightened(tmp_path):
    (tmp_path / "camera.yaml").write_text(
        "image_width: 400\nimage_height: 320\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [450, 0, 200, 0, 450, 160, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [-0.25, 0.05, 0, 0, 0]}\n"
    )
    lens = read_lens(tmp_path / "camera.yaml")
    dots = np.zeros((640, 800, 3), np.uint8)
    cv2.circle(dots, (120, 90), 4, (255, 255, 255), -1)
    photographed.write(tmp_path / "dots.png", dots)
    shot = Photograph.read(tmp_path / "dots.png", lens)
    np.testing.assert_array_equal(Photograph.read(tmp_path / "dots.png", tmp_path / "camera.yaml").image, shot.image)
    seen = np.argwhere(shot.image[..., 0] > 128).mean(axis=0)[::-1]
    np.testing.assert_allclose(shot.pixels_of(np.array([[120.0, 90.0]]))[0], seen, atol=0.3)
    assert np.linalg.norm(seen - [120, 90]) > 5
    photographed.write(tmp_path / "other.png", dots[:, :500])
    with pytest.raises(
        InputError, match=r"other.png: expected a photograph of the camera's ratio 400 x 320, got 500 x"
    ):
        Photograph.read(tmp_path / "other.png", lens)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ("[.nan, 0, 200, 0, 450, 160, 0, 0, 1]", "camera_matrix: expected data, a list of 9 numbers"),
        (f"[1{'0' * 400}, 0, 200, 0, 450, 160, 0, 0, 1]", "camera_matrix: expected data, a list of 9 numbers"),
        ("[f, 0, 200, 0, 450, 160, 0, 0, 1]", "camera_matrix: expected data, a list of 9 numbers"),
        ("[0, 0, 200, 0, 450, 160, 0, 0, 1]", "camera_matrix: expected focal lengths over 0, got 0 and 450"),
        ("[450, 0, 200, 0, 450, 160, 0, 0, 0]", "camera_matrix: expected a last row of 0, 0, 1, got 0, 0, 0"),
    ],
)
def test_a_lens_that_shows_nothing_is_refused(matrix, message, tmp_path):
    """Photographs were straightened to one colour, and the message said that no tiles were found."""
    (tmp_path / "camera.yaml").write_text(
        f"image_width: 400\nimage_height: 320\ncamera_matrix: {{data: {matrix}}}\n"
        "distortion_coefficients: {data: [0, 0, 0, 0]}\n"
    )
    with pytest.raises(InputError, match=f"camera.yaml: {message}"):
        read_lens(tmp_path / "camera.yaml")


def test_numbers_without_a_point_are_read(tmp_path):
    """PyYAML reads 1e-05 as text, but yaml-cpp, by which ROS writes calibrations, writes it."""
    (tmp_path / "camera.yaml").write_text(
        "image_width: 400\nimage_height: 320\ncamera_matrix: {data: [4.5e+02, 0, 2e2, 0, 450, 160, 0, 0, 1]}\n"
        "distortion_coefficients: {data: [1e-05, -1e-3, 0, 0]}\n"
    )
    lens = read_lens(tmp_path / "camera.yaml")
    assert lens.matrix[0].tolist() == [450, 0, 200]
    assert lens.distortion.tolist() == [1e-5, -1e-3, 0, 0]


def test_a_size_that_unfolds_to_a_long_text_is_told_in_short(tmp_path):
    """Aliases of YAML made a message of 15 MB, and with a few more lines one that filled the memory."""
    aliases = "".join(f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n" for level in range(1, 6))
    (tmp_path / "camera.yaml").write_text(
        f"a0: &a0 [1, 1]\n{aliases}image_width: *a5\nimage_height: 1\n"
        "camera_matrix: {data: [450, 0, 200, 0, 450, 160, 0, 0, 1]}\ndistortion_coefficients: {data: [0, 0, 0, 0]}\n"
    )
    with pytest.raises(InputError, match="expected image_width and image_height in pixels, got ") as caught:
        read_lens(tmp_path / "camera.yaml")
    assert len(str(caught.value)) < 400
