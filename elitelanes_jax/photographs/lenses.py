"""Calibrations of lenses: which distortion they have, and pictures without it.

`read_lens` reads the files of ROS's camera_calibration, of Duckietown, of OpenCV's calibration and
of Kalibr, and ROS's messages CameraInfo.
"""

import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, is_real, path
from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax._util.errors import InputError, brief, list_some, reason, yaml_fault
from elitelanes_jax._util.files import MIB, read_text
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.photographs._views import scaling

_EXPECTED = "a camera's calibration"
# The models of distortion of ROS and of Kalibr, by whether they are OpenCV's model of a fisheye lens.
_MODELS = {
    "plumb_bob": False,
    "rational_polynomial": False,
    "equidistant": True,
    "fisheye": True,
}
_KALIBR_MODELS = {"radtan": False, "equidistant": True, "none": False}
# The first line of an INI file: ROS's comment, or the name of a section.
_INI = re.compile(r"# oST|\[[\w/]+\]\s*$", re.MULTILINE)
# The longest side of a picture, in pixels.
_LONGEST_SIDE = 1e5
# The most entries of another file that a message names.
_MOST_NAMED = 6


@keeps_copies
class Lens(NamedTuple):
    """A calibrated camera.

    Attributes:
      matrix: float ``[3, 3]``, of the camera.
      distortion: OpenCV's coefficients; four of a fisheye lens.
      fisheye: whether the model is ROS's `equidistant` or `fisheye`.
      width: the width of its pictures in pixels.
      height: the height of its pictures in pixels.
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    fisheye: bool
    width: int
    height: int

    def scaled(self, image: NDArray[np.uint8]) -> "Lens":
        """Returns the lens for pictures of an image's size, as the sensor has it.

        Raises `InputError` if the sides of the image have another ratio.
        """
        height, width = image.shape[:2]
        if abs(width * self.height - height * self.width) > 0.01 * width * self.height:
            raise InputError(
                "",
                f"a photograph of the camera's ratio {self.width} x {self.height}",
                f"{width} x {height}",
            )
        matrix = scaling(width / self.width, height / self.height) @ self.matrix
        return self._replace(matrix=matrix, width=width, height=height)

    def straighten(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns where pixels ``[N, 2]`` are without the distortion."""
        undistort = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        points = undistort(
            pixels[None].astype(np.float64), self.matrix, self.distortion, P=self.matrix
        )
        return np.asarray(points, np.float64).reshape(-1, 2)

    def straighten_image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Returns an image of the lens's size without the distortion."""
        if self.fisheye:
            return np.asarray(
                cv2.fisheye.undistortImage(image, self.matrix, self.distortion, None, self.matrix)
            )
        return np.asarray(cv2.undistort(image, self.matrix, self.distortion), np.uint8)


class _Loader(yaml.SafeLoader):
    """Reads YAML with the matrices that OpenCV writes."""


_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix",
    lambda loader, node: loader.construct_mapping(node, deep=True),
)


class _Names(NamedTuple):
    """The names of the entries of a kind of file, in lower case."""

    matrix: str
    distortion: str
    width: str
    height: str


_ROS_FILE = _Names("camera_matrix", "distortion_coefficients", "image_width", "image_height")
_CAMERA_INFO = _Names("k", "d", "width", "height")


def read_lens(file: str | Path) -> Lens:
    """Reads the calibration of a camera.

    The file is YAML of ROS's camera_calibration, Duckietown, OpenCV or Kalibr, or a message
    CameraInfo of ROS.

    Raises:
      InputError: for another file; the message names the entry.
    """
    file = Path(check_named("file", path, file))
    values = _read_values(file)
    cameras = [name for name in values if name.startswith("cam") and name[3:].isdigit()]
    if len(cameras) > 1:
        raise InputError(
            file,
            "one camera",
            list_some(cameras, _MOST_NAMED),
            "keep the one that took the photographs",
        )
    if cameras:
        return _read_kalibr(file, cameras[0], values[cameras[0]])
    for names in (_ROS_FILE, _CAMERA_INFO):
        if names.matrix in values:
            return _read_ros(file, values, names)
    listed = list_some([str(brief(name, 30)) for name in values], _MOST_NAMED) or "none"
    entries = "camera_matrix of ROS or OpenCV, K of CameraInfo, or cam0 of Kalibr"
    raise InputError(file, f"{_EXPECTED}: {entries}", listed)


def _read_values(file: Path) -> dict[str, UserValue]:
    """Reads the entries of a file, with their names in lower case."""
    try:
        text = read_text(file, MIB)
    except OSError as error:
        raise InputError(file, _EXPECTED, reason(error)) from None
    except UnicodeDecodeError:
        raise InputError(file, f"{_EXPECTED} in YAML", "another file") from None
    start = text.lstrip()
    if start.startswith("<"):
        raise InputError(file, f"{_EXPECTED} in YAML", "XML", "save it as .yml with OpenCV")
    if _INI.match(start):
        hint = "name the .yaml file next to it"
        raise InputError(file, f"{_EXPECTED} in YAML", "an INI file", hint)
    # OpenCV begins its files with a line that is no YAML.
    text = text.removeprefix("%YAML:1.0")
    try:
        # Messages that ROS prints are documents, one after another.
        values = next(yaml.load_all(text, _Loader), None)
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(file, f"{_EXPECTED} in YAML", yaml_fault(error)) from None
    except RecursionError:
        raise InputError(file, f"{_EXPECTED} in YAML", "lists nested too deeply") from None
    if not isinstance(values, dict):
        return {}
    return {str(name).lower(): value for name, value in values.items()}


def _read_ros(file: Path, values: dict[str, UserValue], names: _Names) -> Lens:
    """Reads the file of a calibration of ROS or OpenCV, or a message."""
    model = values.get("distortion_model", "plumb_bob")
    # OpenCV's own program names no model.
    if values.get("fisheye_model") == 1:
        model = "fisheye"
    fisheye = _model(file, "distortion_model", model, _MODELS)
    sides = values.get(names.width), values.get(names.height)
    size = _size(file, f"{names.width} and {names.height}", *sides)
    _check_whole_sensor(file, values.get("roi"), size)
    matrix = _numbers(file, names.matrix, values[names.matrix], (9,)).reshape(3, 3)
    if not np.array_equal(matrix[2], (0, 0, 1)):
        got = ", ".join(f"{number:g}" for number in matrix[2])
        raise InputError(f"{file}: {names.matrix}", "a last row of 0, 0, 1", got)
    _check_focal_lengths(file, names.matrix, matrix)
    # OpenCV's model of a fisheye lens has four coefficients. Its other model has any of these
    # numbers.
    lengths = (4,) if fisheye else (4, 5, 8, 12, 14)
    distortion = _numbers(file, names.distortion, values.get(names.distortion), lengths)
    return Lens(matrix, distortion, fisheye, *size)


def _check_whole_sensor(file: Path, roi: UserValue, size: tuple[int, int]) -> None:
    """Refuses a message about a part of the sensor, because its matrix is of the whole sensor."""
    if not isinstance(roi, dict):
        return
    part = [roi.get(name, 0) for name in ("x_offset", "y_offset", "width", "height")]
    # Sides of 0 mean the whole sensor.
    if part[:2] != [0, 0] or part[2:] not in ([0, 0], [*size]):
        raise InputError(
            f"{file}: roi", "pictures of the whole sensor", f"a part of it, {brief(part)}"
        )


def _read_kalibr(file: Path, name: str, camera: UserValue) -> Lens:
    """Reads a camera of Kalibr's chain of cameras."""
    entries = camera if isinstance(camera, dict) else {}
    where = f"{name}: "
    _model(file, f"{where}camera_model", entries.get("camera_model"), {"pinhole": False})
    model = entries.get("distortion_model")
    fisheye = _model(file, f"{where}distortion_model", model, _KALIBR_MODELS)
    resolution = entries.get("resolution")
    sides = resolution if isinstance(resolution, list) and len(resolution) == 2 else (None, None)
    size = _size(file, f"{where}resolution, width and height", *sides)
    intrinsics = _numbers(file, f"{where}intrinsics", entries.get("intrinsics"), (4,))
    across, down, x, y = intrinsics.tolist()
    matrix = np.array([[across, 0, x], [0, down, y], [0, 0, 1]])
    _check_focal_lengths(file, f"{where}intrinsics", matrix)
    distortion = np.zeros(4)
    if model != "none":
        coefficients = entries.get("distortion_coeffs")
        distortion = _numbers(file, f"{where}distortion_coeffs", coefficients, (4,))
    return Lens(matrix, distortion, fisheye, *size)


def _model(file: Path, name: str, model: UserValue, known: dict[str, bool]) -> bool:
    """Returns what is known of the model that a file names."""
    if not isinstance(model, str) or model not in known:
        raise InputError(f"{file}: {name}", " or ".join(known), brief(model))
    return known[model]


def _size(file: Path, names: str, *sides: UserValue) -> tuple[int, int]:
    """Returns the width and the height of the camera's pictures. `names` are those of the entries."""
    # Some programs write 640.0.
    numbers = [number for side in sides if (number := _number(side)) is not None]
    if len(numbers) != 2 or not all(_is_side(number) for number in numbers):
        got = f"{brief(sides[0])} and {brief(sides[1])}"
        raise InputError(file, f"{names} in pixels", got)
    width, height = map(int, numbers)
    return width, height


def _is_side(number: float) -> bool:
    return number == round(number) and 0 < number < _LONGEST_SIDE


def _check_focal_lengths(file: Path, name: str, matrix: NDArray[np.float64]) -> None:
    if not (matrix.diagonal()[:2] > 0).all():
        got = f"{matrix[0, 0]:g} and {matrix[1, 1]:g}"
        raise InputError(f"{file}: {name}", "focal lengths over 0", got)


def _numbers(
    file: Path, name: str, entry: UserValue, lengths: tuple[int, ...]
) -> NDArray[np.float64]:
    """Returns the numbers of an entry, which is a list, or has a list named data."""
    data = entry.get("data") if isinstance(entry, dict) else entry
    numbers = [_number(part) for part in data] if isinstance(data, list) else []
    if len(numbers) not in lengths or None in numbers:
        listed = " or ".join(map(str, lengths))
        raise InputError(f"{file}: {name}", f"a list of {listed} numbers", brief(data, 40))
    return np.array(numbers, np.float64)


def _number(value: UserValue) -> float | None:
    """Returns a finite number, or None for anything else."""
    # Other programs write 1e-05, which PyYAML reads as text because it has no point.
    if isinstance(value, str):
        with suppress(ValueError):
            value = float(value)
    # A whole number may be larger than all floats.
    if not is_real(value) or not abs(value) <= sys.float_info.max:
        return None
    return float(value)
