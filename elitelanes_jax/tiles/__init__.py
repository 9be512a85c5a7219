"""Tile pictures: sets of them, their masks, their seams, and maps drawn with them. OpenCV is used here."""
