"""Writes a network as an ONNX file, which runs without JAX, and compares the file with JAX.

    python -m experiments.perception.gym_duckietown.export_onnx {pose,labels} --out FILE [--weights FILE] [--int8]
        [--pictures FILE]

The input `image` has any number of RGB pictures, uint8 [N, 120, 160, 3]. The output of `pose` is `lane`, float32
[N, 3]: tiles to the left of the lane, radians to the left, and the lane's curvature in 1 / tiles. The output of
`labels` is `labels`, uint8 [N, 120, 160], indices of the names in the file's metadata. `--int8` rounds the weights and
the inputs of layers to 8 bits, in ranges that 64 drawn views have. The comparison uses these views too. With a file of
`pictures`, it uses those, and prints the errors of both.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from flax.traverse_util import flatten_dict
from jaxtyping import UInt8
from numpy.typing import NDArray

from elitelanes_jax import DatasetSpec, InputError, load_tiles
from elitelanes_jax.drive import make_scenes
from elitelanes_jax.tiles import LABELS
from experiments.common import Parser, Pytree, Untyped, leave, require, run, write
from experiments.perception.gym_duckietown.evaluate import Finder, label_table, pose_table
from experiments.perception.gym_duckietown.nets import COLUMNS, ROWS, SCALES, find_labels, find_poses, read_weights
from experiments.perception.gym_duckietown.pictures import TILE, read_pictures
from experiments.perception.gym_duckietown.stream import LINES, TILE_PX, stream

__all__ = ["drawn_views", "main", "quantize", "run_onnx", "to_onnx"]

_OPSET = 17  # onnxruntime 1.12 of 2022 and later ones have these operators
_GROUPS, _EPSILON = 4, 1e-6  # of Flax's GroupNorm
_WEIGHTS = Path(__file__).parent / "weights"
_TOWN = Path(__file__).parents[3] / "docs" / "examples" / "town.json"
_MEANINGS = {"pose": ["tiles to the left", "radians to the left", "curvature in 1 / tiles"], "labels": list(LABELS)}
_CAMERA_UNITS = {
    "height": "metres above the ground",
    "forward": "metres ahead of the middle between the wheels",
    "pitch": "degrees downwards",
    "field_of_view": "degrees, from the upper to the lower edge",
    "distortion": "k1, k2 of the radial distortion x (1 + k1 r^2 + k2 r^4), r in focal lengths; null for none",
}
_LIMIT = 1e-5  # of the differences of poses, and of the share of the pixels. Rounding decides ties of two labels.


class _Graph:
    """A graph of ONNX that grows node by node. It finds weights by the names of Flax's layers."""

    def __init__(self, weights: Pytree) -> None:
        self.nodes: list[Untyped] = []
        self.constants: list[Untyped] = []
        self._weights = {name: np.asarray(value) for name, value in flatten_dict(weights["params"], sep="/").items()}

    def constant(self, values: Untyped, dtype: type = np.float32) -> str:
        from onnx import numpy_helper

        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(values, dtype), name))
        return name

    def add(self, operator: str, *inputs: str, name: str | None = None, **attributes: Untyped) -> str:
        """Adds a node; returns the name of its output."""
        from onnx import helper

        name = name or f"{operator}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], name=name, **attributes))
        return name

    def conv(self, x: str, layer: str, stride: int = 1) -> str:
        kernel = self._weights[f"{layer}/kernel"].transpose(3, 2, 0, 1)
        bias = [self.constant(self._weights[f"{layer}/bias"])] if f"{layer}/bias" in self._weights else []
        strides = [stride, stride]  # Flax pads at the end first, as SAME_UPPER does
        return self.add("Conv", x, self.constant(kernel), *bias, auto_pad="SAME_UPPER", strides=strides)

    def group_norm(self, x: str, layer: str) -> str:
        """Adds Flax's GroupNorm and a ReLU."""
        ones, zeros = self.constant(np.ones(_GROUPS)), self.constant(np.zeros(_GROUPS))
        groups = self.add("Reshape", x, self.constant([0, _GROUPS, -1], np.int64))
        normal = self.add("InstanceNormalization", groups, ones, zeros, epsilon=_EPSILON)
        normal = self.add("Reshape", normal, self.add("Shape", x))
        scale, bias = (self.constant(self._weights[f"{layer}/{part}"][:, None, None]) for part in ("scale", "bias"))
        return self.add("Relu", self.add("Add", self.add("Mul", normal, scale), bias))

    def dense(self, x: str, layer: str) -> str:
        return self.add("Gemm", x, *(self.constant(self._weights[f"{layer}/{part}"]) for part in ("kernel", "bias")))


def _add_pose(graph: _Graph, x: str) -> None:
    """Adds `nets.PoseNet`."""
    x = graph.add("AveragePool", x, kernel_shape=[2, 2], strides=[2, 2])
    x = graph.add("Sub", x, graph.add("ReduceMean", x, axes=[1, 2, 3]))
    deviation = graph.add("Sqrt", graph.add("ReduceMean", graph.add("Mul", x, x), axes=[1, 2, 3]))
    x = graph.add("Div", x, graph.add("Add", deviation, graph.constant(8)))
    for index, stride in enumerate((2, 2, 2, 1)):
        x = graph.group_norm(graph.conv(x, f"Conv_{index}", stride), f"GroupNorm_{index}")
    x = graph.add("Relu", graph.conv(x, "Conv_4"))
    x = graph.add("Flatten", graph.add("Transpose", x, perm=[0, 2, 3, 1]))
    x = graph.dense(graph.add("Relu", graph.dense(x, "Dense_1")), "Dense_0")  # Flax names the last one first
    graph.add("Mul", x, graph.constant(SCALES), name="lane")


def _add_labels(graph: _Graph, x: str) -> None:
    """Adds `unet.UNet` with its three levels."""
    layers = iter(range(10))

    def block(x: str) -> str:
        for layer in (next(layers), next(layers)):
            x = graph.group_norm(graph.conv(x, f"Conv_{layer}"), f"GroupNorm_{layer}")
        return x

    x = graph.add("Sub", graph.add("Div", x, graph.constant(128)), graph.constant(1))
    fine = block(graph.add("SpaceToDepth", x, blocksize=2))
    middle = block(graph.add("AveragePool", fine, kernel_shape=[2, 2], strides=[2, 2]))
    x = block(graph.add("AveragePool", middle, kernel_shape=[2, 2], strides=[2, 2]))
    for skip in (middle, fine):
        twice = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
        x = graph.add("Resize", x, "", graph.constant([1, 1, 2, 2]), **twice)
        x = block(graph.add("Concat", x, skip, axis=1))
    x = graph.add("DepthToSpace", graph.conv(x, "Conv_10"), blocksize=2)
    graph.add("Cast", graph.add("ArgMax", x, axis=1, keepdims=0), to=2, name="labels")  # 2 is uint8


def to_onnx(task: str, weights: Pytree, camera: dict[str, float]) -> bytes:
    """Returns an ONNX file of weights of `train`, with its units and the camera's numbers in the metadata."""
    from onnx import TensorProto, checker, helper

    graph = _Graph(weights)
    x = graph.add("Cast", graph.add("Transpose", "image", perm=[0, 3, 1, 2]), to=TensorProto.FLOAT)
    if task == "pose":
        _add_pose(graph, x)
        seen = helper.make_tensor_value_info("lane", TensorProto.FLOAT, ["N", 3], ", ".join(_MEANINGS[task]))
    else:
        _add_labels(graph, x)
        seen = helper.make_tensor_value_info("labels", TensorProto.UINT8, ["N", ROWS, COLUMNS], ", ".join(LABELS))
    image = helper.make_tensor_value_info("image", TensorProto.UINT8, ["N", ROWS, COLUMNS, 3], "RGB")
    made = helper.make_graph(graph.nodes, task, [image], [seen], graph.constants)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=8)
    about = {"image": "RGB, 0 to 255, of the camera", seen.name: _MEANINGS[task], "tile_metres": TILE}
    about |= {"camera": camera, "camera_units": _CAMERA_UNITS}
    helper.set_model_props(model, {name: json.dumps(value) for name, value in about.items()})
    checker.check_model(model, full_check=True)
    content: bytes = model.SerializeToString()
    return content


def quantize(content: bytes, images: UInt8[NDArray, "N 120 160 3"]) -> bytes:
    """Returns the file with 8-bit convolutions and dense layers; pictures give the ranges of the numbers."""
    from onnxruntime import quantization
    from onnxruntime.quantization.shape_inference import quant_pre_process

    class Reader(quantization.CalibrationDataReader):  # type: ignore[misc, unused-ignore]
        def __init__(self) -> None:
            self._images = iter(images)

        def get_next(self) -> Untyped:
            image = next(self._images, None)
            return None if image is None else {"image": image[None]}

    with tempfile.TemporaryDirectory() as folder:
        before, shaped, after = (Path(folder, f"{name}.onnx") for name in ("before", "shaped", "after"))
        before.write_bytes(content)
        quant_pre_process(before, shaped, skip_optimization=True, skip_symbolic_shape=True)
        quantization.quantize_static(shaped, after, Reader(), op_types_to_quantize=["Conv", "Gemm"], per_channel=True)
        return after.read_bytes()


def drawn_views() -> UInt8[NDArray, "64 120 160 3"]:
    """Draws varied views of a town, as `stream` does."""
    scenes = make_scenes([_TOWN], load_tiles(), tile_px=TILE_PX)
    return next(stream("pose", scenes, 0, LINES, 0)).images


def run_onnx(content: bytes, images: UInt8[NDArray, "N 120 160 3"]) -> tuple[NDArray[np.generic], float]:
    """Runs an ONNX file on one core, a picture at a time; returns its outputs, and the median milliseconds."""
    import onnxruntime

    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(content, settings, providers=["CPUExecutionProvider"])
    outputs, seconds = [], []
    for image in images:
        start = time.thread_time()
        outputs.append(session.run(None, {"image": image[None]})[0])
        seconds.append(time.thread_time() - start)
    return np.concatenate(outputs), 1000 * float(np.median(seconds))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("export_onnx", __doc__)
    parser.add_argument("task", choices=_MEANINGS)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".onnx")
    parser.add_argument(
        "--weights", type=Path, metavar="FILE", help="of train or stream; by default the committed ones"
    )
    parser.add_argument("--int8", action="store_true", help="round to 8 bits")
    parser.add_argument("--pictures", type=Path, metavar="FILE", help="of pictures, for the comparison")
    camera = "numbers of the training's camera, such as pitch=15; by default gym-duckietown's"
    parser.add_argument("--camera", nargs="+", default=[], metavar="NAME=VALUE", help=camera)
    options = parser.parse_args(arguments)
    return run("export_onnx", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("export_onnx needs", "onnx", "onnxruntime")
    task, find = options.task, find_poses if options.task == "pose" else find_labels
    camera = DatasetSpec().replace(camera=[f"rows={ROWS}", f"columns={COLUMNS}", *options.camera]).camera
    pictures = None if options.pictures is None else read_pictures(options.pictures)
    weights = read_weights(options.weights or _WEIGHTS / f"{task}.npz", task)
    content = to_onnx(task, weights, {name: getattr(camera, name) for name in (*_CAMERA_UNITS, "rows", "columns")})
    images = drawn_views() if pictures is None else pictures.images
    if options.int8:
        content = quantize(content, drawn_views())
    (outputs, milliseconds), expected = run_onnx(content, images), find(weights, images)
    if task == "pose":
        most = np.abs(outputs - expected).max(axis=0)
        worst, words = float(most.max()), "by at most {:.1e} tiles, {:.1e} radians and {:.1e} / tile".format(*most)
    else:
        worst = float((outputs != expected).mean())
        words = f"in {(outputs != expected).sum()} of {outputs.size} pixels"
    if worst > _LIMIT and not options.int8:
        raise InputError(options.out, "the results of JAX", f"results that differ {words}")
    write(options.out, content)
    print(f"{options.out}: {len(content)} bytes, {milliseconds:.2f} ms a picture on one core")
    print(f"it differs from JAX {words}, in {len(images)} pictures")
    if pictures is not None:
        make_table = pose_table if task == "pose" else label_table
        finders: dict[str, Finder] = {
            "JAX": partial(find, weights),
            "ONNX": lambda images: run_onnx(content, images)[0],
        }
        print(make_table({options.pictures.stem: pictures}, finders))


if __name__ == "__main__":
    leave(main())
