"""Has Ultralytics read datasets, in an environment of its own: python yolo_reads.py DATA.yaml ...

Prints a line of JSON for each: by split, each picture's name with its boxes (class, middle, width and height in pixels)
and the number of its outlines.
"""

import json
import sys
from contextlib import redirect_stdout
from pathlib import Path

with redirect_stdout(sys.stderr):  # the first import on a machine says that it writes a file of settings
    from ultralytics.data.utils import check_det_dataset, img2label_paths, verify_image_label

for file in sys.argv[1:]:
    data, read = check_det_dataset(file, autodownload=False), {}
    for split in ("train", "val", "test"):
        pictures = sorted(map(str, Path(data[split]).iterdir())) if split in data else []
        for picture, text in zip(pictures, img2label_paths(pictures), strict=True):
            task = picture, text, "", False, data["nc"], 0, 0, False
            name, boxes, shape, outlines, _, missing, _, _, damaged, message = verify_image_label(task)
            assert not missing and not damaged and not message, message
            pixels = boxes * [1, shape[1], shape[0], shape[1], shape[0]]
            read.setdefault(split, {})[Path(name).name] = pixels.tolist(), len(outlines)
    print(json.dumps({"names": list(data["names"].values()), "splits": read}))
