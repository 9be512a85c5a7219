"""The study in gym-duckietown: its parts that run without it, and with it the bridge."""

from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.drive import Camera, Pose, look, make_sight, random_pose
from elitelanes_jax.drive.lanes import lane_pose
from elitelanes_jax.tiles import choose_tiles

nets = pytest.importorskip(
    "experiments.perception.gym_duckietown.nets", reason="flax and optax are not here", exc_type=ImportError
)
from experiments.perception.gym_duckietown import rides, score, stream, train  # noqa: E402
from experiments.perception.gym_duckietown.bridge import receive, send  # noqa: E402
from experiments.perception.gym_duckietown.classical import find_lane, find_lines  # noqa: E402
from experiments.perception.gym_duckietown.evaluate import label_table  # noqa: E402
from experiments.perception.gym_duckietown.pictures import Pictures, classes_of  # noqa: E402
from experiments.perception.gym_duckietown.world import PYTHON, DuckietownMap, World  # noqa: E402

LOOP = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8)


def test_messages_are_read_as_they_were_written(tmp_path):
    with (tmp_path / "pipe").open("w+b") as pipe:
        send(pipe, do="look", poses=np.eye(3), count=3)
        send(pipe, error="none")
        pipe.seek(0)
        first, second = receive(pipe), receive(pipe)
        assert receive(pipe) is None
    assert first.pop("poses").tolist() == np.eye(3).tolist()
    assert first == {"do": "look", "count": 3}
    assert second == {"error": "none"}


def test_weights_are_read_as_they_were_written_and_no_others(tmp_path):
    weights = jax.jit(nets.NETS["pose"].init)(jax.random.key(0), np.zeros((1, 120, 160, 3), np.uint8))
    nets.write_weights(tmp_path / "pose.npz", weights)
    assert (tmp_path / "pose.npz").stat().st_size < 500_000
    images = np.random.default_rng(0).integers(0, 256, (2, 120, 160, 3), np.uint8)
    found = nets.find_poses(nets.read_weights(tmp_path / "pose.npz", "pose"), images)
    np.testing.assert_allclose(found, nets.find_poses(weights, images), atol=0.01)
    with refused("images", "an array (2, 60, 160, 3)", expected="120 x 160"):
        nets.find_poses(weights, images[:, :60])
    with refused(tmp_path / "pose.npz", "those of another network"):
        nets.read_weights(tmp_path / "pose.npz", "labels")
    (tmp_path / "text.npz").write_text("nothing")
    with refused(tmp_path / "text.npz", "...", expected="weights of train"):
        nets.read_weights(tmp_path / "text.npz", "pose")
    with refused(tmp_path, "none"):
        train.read_views(tmp_path)
    (tmp_path / "test").mkdir()
    (tmp_path / "test" / "metadata.jsonl").write_text('{"codes": [[6, 3], [12, 9]]}\n')
    with refused(tmp_path, "another one", expected="--camera"):
        train.read_views(tmp_path, "test")


def test_pure_pursuit_holds_the_lane_from_both_sides():
    """A robot that starts beside a straight or a curved lane comes to it and stays on it."""
    for curvature in (0.0, -1 / 0.3, 1 / 0.7):
        d, phi, dt = 0.08, -0.4, 1 / 15
        for _ in range(150):
            left, right = rides.follow(np.array([d, phi, curvature]))
            speed, turn = 0.3 * (left + right), 3.75 * (right - left)
            along = speed * np.cos(phi) / (1 - curvature * d)  # the lane's own arc is longer or shorter
            d += dt * speed / 0.585 * np.sin(phi)
            phi += dt * (turn - along * curvature / 0.585)
        assert abs(d) < 0.02 and abs(phi) < 0.1


@pytest.fixture
def look_along(drawn_tiles):
    """Our camera on a straight road, in the middle of the lane."""
    road = np.full((1, 8), 5, np.int8)
    sight, chosen = make_sight(drawn_tiles, Camera(rows=120, columns=160)), choose_tiles(road, drawn_tiles)

    def look_at(phi):
        pose = Pose(*map(np.float32, (2.5, 0.7, phi)))
        return look(pose, road, sight, chosen=chosen)

    return look_at


def test_colours_and_votes_find_the_lane_on_a_straight_road(look_along):
    d, phi = find_lane(np.asarray(look_along(0.2).image))
    assert abs(d) < 0.08 and abs(phi - 0.2) < 0.11
    assert find_lane(np.zeros((120, 160, 3), np.uint8)).tolist() == [0, 0]
    lines = find_lines(np.uint8([[[255, 255, 255], [230, 200, 20], [220, 20, 30], [60, 60, 60]]]))
    found = {name: line[0].tolist() for name, line in lines.items()}
    assert found == {name: [place == at for at in range(4)] for place, name in enumerate(("white", "yellow", "red"))}


def test_the_kept_weights_see_our_own_road(look_along):
    folder = Path(nets.__file__).parent / "weights"
    assert sum(file.stat().st_size for file in folder.iterdir()) < 1_000_000
    weights, labels = (nets.read_weights(folder / f"{task}.npz", task) for task in ("pose", "labels"))
    views = [look_along(phi) for phi in (-0.3, 0.0, 0.3)]
    images = np.stack([view.image for view in views])
    found = nets.find_poses(weights, images)
    np.testing.assert_allclose(found[:, 1], [-0.3, 0, 0.3], atol=0.15)
    assert np.abs(found[:, 0]).max() < 0.06
    agree = nets.find_labels(labels, images) == np.stack([view.labels for view in views])
    assert agree.mean() > 0.85


def test_networks_are_scored_on_views_that_they_have_not_seen(look_along, tmp_path, capsys):
    folder = Path(nets.__file__).parent / "weights"
    views = [look_along(phi) for phi in (-0.3, 0.0, 0.3)]
    lanes = np.array([[0, phi, 0] for phi in (-0.3, 0.0, 0.3)], np.float32)
    shown = {
        name: np.stack([getattr(view, one) for view in views]) for name, one in (("images", "image"), ("labels",) * 2)
    }
    np.savez(tmp_path / "views.npz", lanes=lanes, **shown)
    assert score.main(["pose", str(folder / "pose.npz"), str(tmp_path / "views.npz")]) == 0
    head, offset, angle = capsys.readouterr().out.splitlines()
    assert head.startswith("3 pictures") and offset.startswith("offset, cm") and angle.startswith("angle, rad")
    assert float(offset.split()[2]) < 0.06 * 58.5 and float(angle.split()[2]) < 0.15
    assert score.main(["labels", str(folder / "labels.npz"), str(tmp_path / "views.npz")]) == 0
    names, shares = zip(*(line.rsplit(maxsplit=1) for line in capsys.readouterr().out.splitlines()), strict=True)
    assert [name.strip() for name in names] == ["background", "road", "stop line", "lane separator"]
    assert float(shares[1]) > 0.8
    assert score.main(["pose", str(folder / "pose.npz"), str(tmp_path)]) == 2
    assert "with a split test, got none" in capsys.readouterr().err


def test_classes_are_those_of_the_nearest_colour():
    image = np.uint8([[[120, 130, 127], [3, 0, 5], [250, 9, 0], [240, 250, 20], [250, 250, 250], [255, 0, 255]]])
    assert classes_of(image).tolist() == [[0, 1, 2, 3, 4, 0]]


def test_the_report_counts_rides():
    ok = {"seconds": 60, "on_road": 1.0, "no_hit": 1.0, "metres": 15.0, "oncoming": 0.0}
    kept = {"loop": {"objects": 0, "rides": [ok, ok | {"on_road": 0.0}]}, "town 0": {"objects": 0, "rides": [ok]}}
    text = rides.report(kept)
    assert "| people's maps, no objects | 2 | 50% | 50% | 50% | 15.0 |" in text
    assert "| our towns | 1 | 100% | 100% | 100% | 15.0 |" in text


def test_ious_beside_white_lines_are_left_out():
    """The network takes the pixels of a white line and of the three beside it for road; everything else is right."""
    labels, white = np.zeros((1, 120, 160), np.uint8), np.zeros((1, 120, 160), bool)
    labels[:, 60:, :80], labels[:, 60:, 30:33], white[:, 60:, 80:84] = 1, 3, True
    found = labels.copy()
    found[:, 60:, 80:87] = 1
    none = np.zeros((1, 120, 160, 3), np.uint8)
    nothing = np.zeros((1, 3)), np.zeros((1, 2)), np.zeros(1), np.zeros(1, bool)
    # The labels that fit have no white line, and are what the network found.
    pictures = Pictures(none, labels, *nothing, white, found, np.zeros_like(white))
    fitting, own, both = label_table({"photos": pictures}, {"net": lambda images: found}).splitlines()[2:]
    assert fitting.split(" | ")[:3] == ["| photos", "fitting", "net"]
    assert fitting.split(" | ")[3:] == ["1.000", "1.000", "nan", "1.000", "1.000", "1.000 |"]
    share = 77 / 84
    assert own.split(" | ")[3:] == ["0.971", f"{share:.3f}", "nan", "1.000", f"{80 / 87:.3f}", "1.000 |"]
    assert (
        both.split(" | ")[1:3] == ["gym-duckietown's", "fitting labels"]
        and both.split(" | ")[3:] == own.split(" | ")[3:]
    )


@pytest.mark.slow
def test_training_continues_to_the_same_weights(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    images, labels = rng.integers(0, 256, (8, 120, 160, 3), np.uint8), rng.integers(0, 4, (8, 120, 160), np.uint8)
    views, file = train.Views(images, labels, np.zeros((8, 3), np.float32)), tmp_path / "checkpoint"

    batches, shares = partial(train.draw_batches, "pose", views, 0), train.shares_of(views.labels)
    whole = train.train_on("pose", batches, shares, 3, 0, tmp_path / "whole", print)

    def stop(_: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "_KEEP_EVERY", 0)
    with pytest.raises(KeyboardInterrupt):
        train.train_on("pose", batches, shares, 3, 0, file, stop)
    again = train.train_on("pose", batches, shares, 3, 0, file, print)
    jax.tree.map(np.testing.assert_array_equal, jax.device_get(whole), jax.device_get(again))


def test_without_the_environment_one_line_says_so(tmp_path):
    with refused(tmp_path / "python", "no file"):
        World(tmp_path / "python")


@pytest.mark.slow
@pytest.mark.skipif(not PYTHON.exists(), reason="make gym-duckietown")
def test_the_bridge_sees_poses_as_we_do_and_says_what_is_wrong():
    from elitelanes_jax.formats.duckietown import to_duckietown

    place = DuckietownMap("loop", to_duckietown(LOOP), LOOP)
    poses = np.array([random_pose(key, LOOP) for key in jax.random.split(jax.random.key(0), 30)], float)
    straight = np.isin(LOOP[poses[:, 1].astype(int), poses[:, 0].astype(int)], (5, 10))
    near = jax.vmap(lambda pose: lane_pose(LOOP, Pose(*pose)))(poses.astype(np.float32))
    with World() as world:
        assert world.load(place)["tile_size"] == 0.585
        answer = world.ask("look", poses=poses)
        ours = np.column_stack([near.d * 0.585, near.phi])
        np.testing.assert_allclose(answer["lane"][straight], ours[straight], atol=1e-4)
        assert answer["image"].shape == (30, 480, 640, 3)
        world.load(place, style="labels")
        classes = classes_of(world.ask("look", poses=poses[:2])["image"])
        assert {0, 1, 4} <= set(np.unique(classes).tolist())
        world.load(place)
        seen = world.ask("start", pose=poses[0])
        moved = world.ask("step", action=np.array([0.4, 0.4]), frames=30)
        assert 0.1 < 0.585 * np.hypot(*(moved["pose"] - seen["pose"])[:2]) < 0.4
        world.ask("start", pose=poses[0])
        before = world.ask("step", action=np.array([0.2, 0.3]), frames=90)["pose"]
        after = world.ask("step", action=np.array([0.2, 0.3]))["pose"]  # the limits that `drive.Robot` names
        np.testing.assert_allclose(0.585 * np.hypot(*(after - before)[:2]), 0.3 * 0.5 / 30, rtol=0.01)
        np.testing.assert_allclose(after[2] - before[2], 3.75 * 0.1 / 30, rtol=0.01)
        with refused("luck: gym-duckietown", expected="to load"):
            world.load(DuckietownMap("luck", "tiles: 3", LOOP))


@pytest.mark.slow
def test_a_network_is_trained_from_a_stream(tmp_path):
    file = tmp_path / "pose.npz"
    assert stream.main(["pose", "docs/examples/town.json", "--out", str(file), "--steps", "2"]) == 0
    nets.read_weights(file, "pose")
    assert sorted(tmp_path.iterdir()) == [file]
