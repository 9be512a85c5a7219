"""What is in folders, for tests that compare them."""

import cv2

__all__ = ["files", "read_picture"]


def files(folder):
    """Returns the bytes of all files within a folder, by path."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def read_picture(file):
    """Returns a picture as it is stored; colours are BGR."""
    return cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
