"""Files of photographs and of calibrations, at which size and how upright they are read, and what is refused."""

import struct
import time
import zlib

import cv2
import numpy as np
import photographed
import pytest
import simplejpeg
from refusals import refused

from elitelanes_jax.photographs import (
    Photograph,
    _picture_files,
)
from elitelanes_jax.photographs._jpeg import is_damaged, read_header
from elitelanes_jax.photographs.lenses import read_lens

TOWN = photographed.TOWN


def with_exif(content, orientation, order="MM"):
    """A JPEG or PNG file, with EXIF data that say how the camera was held."""
    number = ">H" if order == "MM" else "<H"
    entry = struct.pack(number[0] + "HHIHH", 0x0112, 3, 1, orientation, 0)
    exif = order.encode() + struct.pack(number[0] + "HIH", 42, 8, 1) + entry + bytes(4)
    if content[:4] == b"\x89PNG":  # the header ends at byte 33
        part = b"eXIf" + exif
        return content[:33] + len(exif).to_bytes(4) + part + zlib.crc32(part).to_bytes(4) + content[33:]
    segment = b"Exif\0\0" + exif
    return content[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2) + segment + content[2:]


ORIENTATIONS = range(1, 9)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_photographs_are_upright_as_other_programs_show_them(suffix, tmp_path):
    content = cv2.imencode(suffix, photographed.photograph(TOWN)[:240, :320])[1].tobytes()
    for orientation in (*ORIENTATIONS, 0, 9):
        for order in ("MM", "II"):
            turned = with_exif(content, orientation, order)
            (tmp_path / f"turned{suffix}").write_bytes(turned)
            shown = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR_RGB)
            np.testing.assert_array_equal(Photograph.read(tmp_path / f"turned{suffix}").image, shown)


def test_large_photographs_are_read_smaller(tmp_path, monkeypatch):
    photographed.write(tmp_path / "plain.jpg", photographed.photograph(TOWN))
    monkeypatch.setattr(_picture_files, "_MOST_READ", 800 * 640 / 3)
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
    monkeypatch.setattr(_picture_files, "_MOST_READ", 60_000)
    with refused(tmp_path / "stray.jpg", "200 x 150", expected="at least 200"):  # read at a half
        Photograph.read(tmp_path / "stray.jpg")
    monkeypatch.setattr(_picture_files, "_MOST_PIXELS", 100_000)
    with refused(tmp_path / "stray.jpg", "400 x 300", expected="at most 0.1"):
        Photograph.read(tmp_path / "stray.jpg")


def test_fill_bytes_take_no_longer_than_others():
    """40,000 of them took 15 s."""
    began = time.process_time()
    assert read_header(jpeg_with(b"\xff" * 40_000 + b"\0")).width == 400
    assert time.process_time() - began < 1


def test_a_photograph_that_opencv_cannot_sample_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(_picture_files, "_MOST_SIDE", 399)
    (tmp_path / "long.jpg").write_bytes(jpeg_with(b""))
    with refused(tmp_path / "long.jpg", "400 x 300", expected="at most 399"):
        Photograph.read(tmp_path / "long.jpg")


def test_a_jpeg_without_a_frame_header_is_refused(tmp_path):
    content = jpeg_with(b"")
    (tmp_path / "cut.jpg").write_bytes(content[: content.index(b"\xff\xc0")] + b"\xff\xd9")
    with refused(tmp_path / "cut.jpg", "one that cannot be read"):
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
    with refused(tmp_path / "floor.png", "one that cannot be read"):
        Photograph.read(tmp_path / "floor.png")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("sampling", ["444", "420"])
def test_a_slightly_tilted_edge_and_coarse_texture_are_no_damage(sampling):
    """The edge of a table leaves a row of blocks at its bottom on one side, and at its top on the other."""
    rows, columns = np.mgrid[:240, :1600]
    rng = np.random.default_rng(0)
    texture = cv2.resize(rng.integers(0, 255, (30, 40, 3), np.uint8), (640, 480), interpolation=cv2.INTER_CUBIC)
    edges = [
        rows + np.tan(np.radians(tilt)) * columns > 120 + start for tilt in (0.3, 0.6, 1.0) for start in range(0, 16, 3)
    ]
    for image in (texture, *(np.where(edge[..., None], 170, 110).repeat(3, 2).astype(np.uint8) for edge in edges)):
        content = simplejpeg.encode_jpeg(np.ascontiguousarray(image), 90, "BGR", sampling)
        assert not is_damaged(read_header(content))


@pytest.mark.parametrize("shape", [(1, 1), (8, 300), (300, 8)])
def test_pictures_of_few_blocks_are_no_damage(shape):
    assert not is_damaged(read_header(simplejpeg.encode_jpeg(np.zeros((*shape, 3), np.uint8))))


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("damage", ["random", "zeros", "ones", "missing", "unfinished"])
def test_a_damaged_jpeg_is_named_without_complaints_of_the_decoder(progressive, damage, tmp_path, capfd):
    """Everything after the damage was shifted or coloured, and a set of these tiles had no problems."""
    flags = [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive]
    content = cv2.imencode(".jpg", photographed.photograph(TOWN), flags)[1].tobytes()
    middle, end, rng = len(content) // 2, len(content) // 2 + 400, np.random.default_rng(0)
    stretch = {"random": rng.bytes(400), "zeros": bytes(400), "ones": b"\xff" * 400, "missing": b"", "unfinished": b""}
    damaged = content[:middle] + stretch[damage] + (content[end:] if damage != "unfinished" else b"")
    (tmp_path / "floor.jpg").write_bytes(damaged)
    capfd.readouterr()
    with refused(tmp_path / "floor.jpg", "a file with a damaged stretch"):
        Photograph.read(tmp_path / "floor.jpg")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "sampling", [pytest.param(sampling, marks=pytest.mark.slow) for sampling in (0x111111, 0x211111)] + [0x221111]
)
def test_one_changed_byte_that_shifts_what_follows_is_damage(sampling):
    """The decoder complains of half of these files. A shift of few pixels or by few levels is no damage."""
    plain = np.array(photographed.photograph(TOWN))
    flags = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    content, rng = cv2.imencode(".jpg", plain, flags)[1].tobytes(), np.random.default_rng(2)
    assert not is_damaged(read_header(content))
    decoded, named, harmful = cv2.imdecode(np.frombuffer(content, np.uint8), 1).astype(int), 0, 0
    for place in rng.integers(len(content) // 10, len(content) * 9 // 10, 120):
        changed = bytearray(content)
        changed[place] ^= int(rng.integers(1, 256))
        header = read_header(bytes(changed))
        if is_damaged(header):
            named += 1
            continue
        picture = cv2.imdecode(np.frombuffer(bytes(changed), np.uint8), 1)
        harmful += (np.abs(picture - decoded).max(axis=2) > 16).mean() > 0.02
    assert named > 24 and harmful <= 6


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
    with refused(tmp_path / "floor.png", "one with some"):
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

    with refused(tmp_path / "floor.png", "one with some"):
        Photograph.read(write(most // 2))
    if depth > 1:  # no pixel has the declared grey
        assert (Photograph.read(write(most // 2 + 1)).image[20:] == 255).all()


def calibration(width=400, height=320):
    """A lens whose axis is beside the middle of its pictures, and which is not the same in all directions."""
    return (
        f"image_width: {width}\nimage_height: {height}\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [450, 0, 212, 0, 440, 149, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [-0.25, 0.05, 0.01, -0.02, 0]}\n"
    )


@pytest.mark.parametrize("orientation", ORIENTATIONS)
@pytest.mark.parametrize("size", [(800, 640), (640, 640)])
def test_the_lens_turns_with_the_picture(orientation, size, tmp_path):
    """It was applied to the upright picture: corners were off by 2.2 % of a tile, and portraits were refused."""
    (tmp_path / "camera.yaml").write_text(calibration(*size))
    lens = read_lens(tmp_path / "camera.yaml")
    dots = np.zeros((size[1], size[0], 3), np.uint8)
    cv2.circle(dots, (330, 300), 4, (255, 255, 255), -1)
    content = cv2.imencode(".png", dots)[1].tobytes()
    (tmp_path / "plain.png").write_bytes(content)
    (tmp_path / "turned.png").write_bytes(with_exif(content, orientation))
    plain = Photograph.read(tmp_path / "plain.png", lens)
    turned = Photograph.read(tmp_path / "turned.png", lens)
    # Turning afterwards is what other programs would do with the straightened picture.
    straight = cv2.imencode(".png", plain.image[..., ::-1])[1].tobytes()
    shown = cv2.imdecode(np.frombuffer(with_exif(straight, orientation), np.uint8), cv2.IMREAD_COLOR_RGB)
    np.testing.assert_array_equal(turned.image, shown)
    viewed = cv2.imdecode(np.frombuffer(with_exif(content, orientation), np.uint8), cv2.IMREAD_GRAYSCALE)
    dot, seen = (np.argwhere(picture > 128).mean(axis=0)[None, ::-1] for picture in (viewed, turned.image[..., 0]))
    np.testing.assert_allclose(turned.pixels_of(dot), seen, atol=0.5)
    assert np.linalg.norm(seen - dot) > 5


def test_a_calibrated_lens_is_straightened(tmp_path):
    (tmp_path / "camera.yaml").write_text(calibration())
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
    with refused(tmp_path / "other.png", "500 x 640", expected="400 x 320"):
        Photograph.read(tmp_path / "other.png", lens)


@pytest.mark.parametrize(
    ("matrix", "got"),
    [
        ("[.nan, 0, 200, 0, 450, 160, 0, 0, 1]", "[nan, 0, 200, 0, 450, 160, ...]"),
        (f"[1{'0' * 400}, 0, 200, 0, 450, 160, 0, 0, 1]", "[1000...000..."),
        ("[f, 0, 200, 0, 450, 160, 0, 0, 1]", "['f', 0, 200, 0, 450, 160, ...]"),
        ("[0, 0, 200, 0, 450, 160, 0, 0, 1]", "0 and 450"),
        ("[450, 0, 200, 0, 450, 160, 0, 0, 0]", "0, 0, 0"),
    ],
)
def test_a_lens_that_shows_nothing_is_refused(matrix, got, tmp_path):
    """Photographs were straightened to one colour, and the message said that no tiles were found."""
    (tmp_path / "camera.yaml").write_text(
        f"image_width: 400\nimage_height: 320\ncamera_matrix: {{data: {matrix}}}\n"
        "distortion_coefficients: {data: [0, 0, 0, 0]}\n"
    )
    with refused(f"{tmp_path / 'camera.yaml'}: camera_matrix", got):
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
    with refused(tmp_path / "camera.yaml", "[[[[[[1, 1], ... and 1") as caught:
        read_lens(tmp_path / "camera.yaml")
    assert len(str(caught.value)) < 400


MATRIX, BENT = "450, 0, 212, 0, 440, 149, 0, 0, 1", "-0.25, 0.05, 0.01, -0.02"
SENSOR = "width: 400\nheight: 320\n"
KALIBR = "camera_model: pinhole\n  intrinsics: [450, 440, 212, 149]\n  resolution: [400, 320]\n"
LENSES = {
    "ROS": f"image_width: 400\nimage_height: 320\ncamera_name: duckiebot\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    f"  data: [{MATRIX}]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  data: [{BENT}, 0]\n",
    "whole numbers with a point": f"image_width: 400.0\nimage_height: 320.0\ncamera_matrix: {{data: [{MATRIX}]}}\n"
    f"distortion_coefficients: {{data: [{BENT}]}}\n",
    "OpenCV": '%YAML:1.0\n---\ncalibration_time: "Mon 01 Jan"\nimage_width: 400\nimage_height: 320\nflags: 0\n'
    f"camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ {MATRIX} ]\n"
    f"distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ {BENT}, 0. ]\n",
    "OpenCV's JSON": '{"image_width": 400, "image_height": 320, "camera_matrix": {"type_id": "opencv-matrix", '
    f'"rows": 3, "cols": 3, "dt": "d", "data": [{MATRIX}]}}, "distortion_coefficients": {{"data": [{BENT}, 0]}}}}',
    "older OpenCV": "%YAML:1.0\nimage_Width: 400\nimage_Height: 320\n"
    f"Camera_Matrix: !!opencv-matrix\n   data: [ {MATRIX} ]\n"
    f"Distortion_Coefficients: !!opencv-matrix\n   data: [ {BENT} ]\n",
    "CameraInfo of ROS 1": f"header:\n  seq: 1\n{SENSOR}distortion_model: plumb_bob\nD: [{BENT}, 0.0]\nK: [{MATRIX}]\n"
    "R: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nbinning_x: 0\nroi: {x_offset: 0, y_offset: 0, height: 0, width: 0}\n---\n",
    "CameraInfo of ROS 2": f"{SENSOR}distortion_model: plumb_bob\nd:\n"
    + "".join(f"- {number}\n" for number in BENT.split(", "))
    + "k:\n"
    + "".join(f"- {number}\n" for number in MATRIX.split(", "))
    + "---\nwidth: 7\n",
    "Kalibr": f"cam0:\n  {KALIBR}  distortion_model: radtan\n  distortion_coeffs: [{BENT}]\n  rostopic: /camera\n",
}


@pytest.mark.parametrize("kind", LENSES)
def test_calibrations_of_other_programs_are_read(kind, tmp_path):
    (tmp_path / "camera.yaml").write_text(LENSES[kind])
    lens = read_lens(tmp_path / "camera.yaml")
    assert lens.matrix.ravel().tolist() == [float(number) for number in MATRIX.split(", ")]
    assert lens.distortion[:4].tolist() == [float(number) for number in BENT.split(", ")]
    assert not lens.distortion[4:].any() and not lens.fisheye
    assert (lens.width, lens.height) == (400, 320)


def test_fisheye_lenses_of_other_programs_are_read(tmp_path):
    fisheye = {
        "OpenCV": LENSES["OpenCV"].replace(", 0. ]", "]") + "fisheye_model: 1\n",
        "Kalibr": LENSES["Kalibr"].replace("radtan", "equidistant"),
        "ROS": LENSES["CameraInfo of ROS 2"].replace("plumb_bob", "equidistant"),
    }
    for text in fisheye.values():
        (tmp_path / "camera.yaml").write_text(text)
        assert read_lens(tmp_path / "camera.yaml").fisheye
    (tmp_path / "camera.yaml").write_text(LENSES["Kalibr"].replace("radtan", "none"))
    assert not read_lens(tmp_path / "camera.yaml").distortion.any()


@pytest.mark.parametrize(
    ("text", "subject", "got", "expected"),
    [
        ('<?xml version="1.0"?>\n<opencv_storage/>', "...camera.yaml", "XML", ""),
        ("# oST version 5.0 parameters\n[image]\n", "...camera.yaml", "an INI file", ""),
        ("[camera/camera_matrix]\n1 0 0\n", "...camera.yaml", "an INI file", ""),
        ("[1, 2]\n", "...camera.yaml", "none", ""),
        (
            "[[1, 2],\nb: 3",
            "...camera.yaml",
            "a fault at line ..., column ..., while parsing a flow sequence from line 1, column 1: ...",
            "",
        ),
        ("K: \x07\n", "...camera.yaml", "... not allowed at ...", ""),
        ("M1: [1]\nD1: [1]\n", "...camera.yaml", "'m1', 'd1'", ""),
        ("- 1\n", "...camera.yaml", "none", ""),
        (f"cam0:\n  {KALIBR}cam1:\n  {KALIBR}", "...camera.yaml", "cam0, cam1", ""),
        ("cam0: {camera_model: omni}", "...camera.yaml: cam0: camera_model", "'omni'", ""),
        (f"cam0:\n  {KALIBR}  distortion_model: fov\n", "...camera.yaml: cam0: distortion_model", "'fov'", "radtan"),
        (LENSES["Kalibr"].replace("[450, ", "["), "...camera.yaml: cam0: intrinsics", "[440, 212, 149]", ""),
        (
            LENSES["Kalibr"].replace("400, 320", "400"),
            "...camera.yaml",
            "None and None",
            "",
        ),
        (
            LENSES["ROS"].replace("plumb_bob", "telecentric"),
            "...camera.yaml: distortion_model",
            "'telecentric'",
            "plumb_bob",
        ),
        (LENSES["ROS"].replace("image_width: 400", "image_width: 400.5"), "...camera.yaml", "400.5 and 320", ""),
        (
            LENSES["CameraInfo of ROS 1"].replace("x_offset: 0", "x_offset: 8"),
            "...camera.yaml: roi",
            "a part of it, [8, 0, 0, 0]",
            "",
        ),
        (LENSES["CameraInfo of ROS 1"].replace(f"K: [{MATRIX}]", "K: [0, 0, 0]"), "...camera.yaml: k", "[0, 0, 0]", ""),
        (LENSES["CameraInfo of ROS 1"].replace("K: [450", "K: [0"), "...camera.yaml: k", "0 and 440", ""),
    ],
)
def test_other_calibrations_are_refused_by_what_they_are(text, subject, got, expected, tmp_path):
    (tmp_path / "camera.yaml").write_text(text)
    with refused(subject, got, expected):
        read_lens(tmp_path / "camera.yaml")
