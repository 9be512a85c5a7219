"""Compares pictures that processors of other instruction sets would draw: of `views`, and of `dataset --camera`.

    python -m experiments.perception.instruction_sets [--pictures N]

Each is drawn twice, by other processes, with XLA_FLAGS=--xla_cpu_max_isa=AVX2 and SSE4_2. The second dataset is also
drawn without AVX in NumPy (NPY_DISABLE_CPU_FEATURES) and OpenCV (OPENCV_CPU_DISABLE). Needs an x86-64 processor with
AVX2.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from elitelanes_jax import InputError
from experiments.common import Parser, leave, run, whole

__all__ = ["main"]

_MAP = Path(__file__).parents[2] / "docs/examples/town.json"
_OPENCV = "AVX,FP16,AVX2,FMA3,AVX_512F,AVX512-COMMON,AVX512-SKX,AVX512-CNL,AVX512-CLX,AVX512-ICL"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("instruction_sets", __doc__)
    parser.add_argument("--pictures", type=whole(1), default=32, metavar="N", help="of views and of the dataset")
    parser.add_argument("--draw", type=Path, metavar="FILE", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.draw is not None:
        return run("instruction_sets", lambda: _draw_views(options.draw, options.pictures))
    return run("instruction_sets", lambda: _compare(options.pictures))


def _compare(pictures: int) -> None:
    with TemporaryDirectory() as folder:
        first, second = Path(folder, "AVX2.npz"), Path(folder, "SSE4_2.npz")
        for file in (first, second):
            command: list[str | Path] = [
                "-m",
                "experiments.perception.instruction_sets",
                "--pictures",
                f"{pictures}",
                "--draw",
                file,
            ]
            _start(command, _xla_with(file.stem))
        _report_views(dict(np.load(first)), dict(np.load(second)))
        usual, plain = Path(folder, "usual"), Path(folder, "plain")
        for out, features in (
            (usual, _xla_with("AVX2")),
            (
                plain,
                {"NPY_DISABLE_CPU_FEATURES": _numpy_features(), "OPENCV_CPU_DISABLE": _OPENCV} | _xla_with("SSE4_2"),
            ),
        ):
            options = ["--camera", "--transform", "varied", "--views", f"{pictures}", "--split", "1", "0", "0"]
            _start(["-m", "elitelanes_jax", "dataset", "--maps-from", _MAP, *options, "--out", out], features)
        _report_dataset(usual, plain)


def _xla_with(instructions: str) -> dict[str, str]:
    return {"XLA_FLAGS": f"--xla_cpu_max_isa={instructions}"}


def _numpy_features() -> str:
    """Returns what NumPy uses beyond its baseline, which alone it can do without."""
    return " ".join(np.show_config(mode="dicts")["SIMD Extensions"]["found"])


def _start(command: Sequence[str | Path], environment: Mapping[str, str]) -> None:
    ended = subprocess.run(
        [sys.executable, *command], env={**os.environ, **environment}, capture_output=True, text=True
    )
    if ended.returncode:
        raise InputError("", f"{' '.join(map(str, command[:3]))} to end", ended.stderr.strip()[-300:])


def _draw_views(file: Path, pictures: int) -> None:
    import jax

    from elitelanes_jax.drive import Camera, Variation, make_scenes, views

    camera = Camera(rows=120, columns=160)
    drawn = views(jax.random.key(0), make_scenes([_MAP]), pictures, camera=camera, variation=Variation.varied())
    poses = np.stack(drawn.poses, axis=1)
    np.savez(file, images=drawn.images, labels=drawn.labels, lanes=drawn.lanes, poses=poses)


def _report_views(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> None:
    away = np.abs(first["images"].astype(int) - second["images"])
    pictures = (away > 0).any(axis=(1, 2, 3)).sum()
    print(
        f"views: {pictures} of {len(away)} differ, {1e6 * (away > 0).mean():.1f} of a million colours, by {away.max()}"
    )
    for name in ("labels", "lanes", "poses"):
        print(f"views, {name}: {(first[name] != second[name]).sum()} of {first[name].size} numbers differ")


def _report_dataset(usual: Path, plain: Path) -> None:
    for layer in ("image", "labels"):
        files = sorted(file.relative_to(usual) for file in usual.glob(f"train/{layer}/*.png"))
        differ = [file for file in files if (usual / file).read_bytes() != (plain / file).read_bytes()]
        print(f"dataset: {len(differ)} of {len(files)} files of {layer} differ")
    records = [(out / "train" / "metadata.jsonl").read_text().splitlines() for out in (usual, plain)]
    changed = sum(json.loads(one) != json.loads(other) for one, other in zip(*records, strict=True))
    print(f"dataset: {changed} of {len(records[0])} records differ")


if __name__ == "__main__":
    leave(main())
