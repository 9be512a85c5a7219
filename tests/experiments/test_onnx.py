"""Networks as ONNX files: the results of JAX, the metadata, and the node that drives by the file alone."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import jax
import numpy as np
import pytest
from refusals import refused

onnx = pytest.importorskip("onnx", reason="onnx is not here")
onnxruntime = pytest.importorskip("onnxruntime", reason="onnxruntime is not here")
nets = pytest.importorskip(
    "experiments.perception.gym_duckietown.nets", reason="flax and optax are not here", exc_type=ImportError
)
from experiments.perception.gym_duckietown import export_onnx, rides, robot_node  # noqa: E402


@pytest.fixture(scope="module")
def images():
    """Noise with coarse patterns, so that the networks find different things."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (4, 6, 8, 3), np.uint8)
    return np.stack([cv2.resize(image, (160, 120)) for image in coarse]) // 2 + rng.integers(
        0, 128, (4, 120, 160, 3), np.uint8
    )


@pytest.fixture(scope="module")
def pose_file(tmp_path_factory, images):
    """The committed weights, exported by the command in pictures of a file."""
    file = tmp_path_factory.mktemp("onnx") / "pose.onnx"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(export_onnx, "drawn_views", lambda: images)
        assert export_onnx.main(["pose", "--out", str(file), "--camera", "pitch=15"]) == 0
        assert export_onnx.main(["pose", "--out", str(file.with_name("int8.onnx")), "--int8"]) == 0
    return file


@pytest.mark.parametrize("task", ["pose", "labels"])
def test_random_weights_give_the_results_of_jax(task, images):
    weights = jax.jit(nets.NETS[task].init)(jax.random.key(0), images[:1])
    weights = jax.tree.map(lambda part: part + 0.1 * np.random.default_rng(0).normal(size=part.shape), weights)
    content = export_onnx.to_onnx(task, weights, {})
    outputs, _ = export_onnx.run_onnx(content, images)
    (together,) = onnxruntime.InferenceSession(content).run(None, {"image": images})
    np.testing.assert_allclose(together, outputs, atol=2e-5)
    expected = {"pose": nets.find_poses, "labels": nets.find_labels}[task](weights, images)
    assert (outputs.dtype, outputs.shape) == (expected.dtype, expected.shape)
    assert len(np.unique(expected)) == (12 if task == "pose" else 4)
    if task == "pose":
        np.testing.assert_allclose(outputs, expected, atol=2e-5)
    else:
        assert (outputs != expected).mean() < 1e-4


def test_the_file_says_what_goes_in_and_out(pose_file):
    model = onnx.load(pose_file)
    about = {entry.key: json.loads(entry.value) for entry in model.metadata_props}
    assert about["tile_metres"] == 0.585
    assert about["camera"] == {**about["camera"], "pitch": 15, "height": 0.108, "rows": 120, "columns": 160}
    assert about["lane"] == ["tiles to the left", "radians to the left", "curvature in 1 / tiles"]
    assert [(one.name, len(one.type.tensor_type.shape.dim)) for one in (*model.graph.input, *model.graph.output)] == [
        ("image", 4),
        ("lane", 2),
    ]
    assert pose_file.with_name("int8.onnx").stat().st_size < pose_file.stat().st_size / 3


def test_the_node_drives_as_the_rides_do(pose_file, images, monkeypatch):
    large = np.stack([cv2.resize(image, (640, 480), interpolation=cv2.INTER_CUBIC) for image in images])
    jax_driver = rides.read_driver(Path(nets.__file__).parent / "weights" / "pose.npz", policy=False)
    onnx_driver = rides.read_driver(pose_file, policy=False)
    for image in large:
        np.testing.assert_allclose(
            onnx_driver({"image": image}), np.clip(jax_driver({"image": image}), -1, 1), atol=1e-4
        )
    sent = run_in_ros(robot_node.Pilot(str(pose_file)), cv2.imencode(".png", large[0][..., ::-1])[1], monkeypatch)
    np.testing.assert_allclose(sent["wheels"], onnx_driver({"image": large[0]}))
    assert len(sent["lane"]) == 3


def run_in_ros(pilot, data, monkeypatch):
    """What the node publishes for one picture, in place of ROS 2 the few calls that it makes."""
    sent, subscribed = {}, {}
    node = SimpleNamespace(
        create_publisher=lambda kind, topic, depth: SimpleNamespace(
            publish=lambda message: sent.update({topic: message.data})
        ),
        create_subscription=lambda kind, topic, call, depth: subscribed.update({topic: call}),
    )
    spin = lambda node: subscribed["image/compressed"](SimpleNamespace(data=data.tobytes()))  # noqa: E731
    kinds = SimpleNamespace(CompressedImage=SimpleNamespace, Float32MultiArray=SimpleNamespace)
    fakes = {"rclpy": SimpleNamespace(init=lambda: None, create_node=lambda name: node, spin=spin)}
    for name in ("sensor_msgs", "sensor_msgs.msg", "std_msgs", "std_msgs.msg"):
        fakes[name] = kinds
    for name, fake in fakes.items():
        monkeypatch.setitem(sys.modules, name, fake)
    robot_node.spin(pilot, "ros")
    return sent


def test_a_wrong_export_is_not_written(tmp_path, images, monkeypatch, capsys):
    monkeypatch.setattr(export_onnx, "drawn_views", lambda: images)
    monkeypatch.setattr(export_onnx, "run_onnx", lambda content, images: (np.ones((4, 3)), 1.0))
    assert export_onnx.main(["pose", "--out", str(tmp_path / "pose.onnx")]) == 2
    assert "expected the results of JAX, got results that differ by at most" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_other_files_are_refused(tmp_path, images):
    weights = jax.jit(nets.NETS["labels"].init)(jax.random.key(0), images[:1])
    (tmp_path / "labels.onnx").write_bytes(export_onnx.to_onnx("labels", weights, {}))
    (tmp_path / "text.onnx").write_text("nothing")
    for name in ("labels", "text", "missing"):
        with refused(tmp_path / f"{name}.onnx", expected="export_onnx pose"):
            rides.read_driver(tmp_path / f"{name}.onnx", policy=False)
    with refused(tmp_path / "labels.onnx", "an ONNX file", expected="policy"):
        rides.read_driver(tmp_path / "labels.onnx", policy=True)
