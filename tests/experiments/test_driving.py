"""The programs that measure driving and devices run on a few maps, and say what they found. And a driver that sees."""

from pathlib import Path

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.drive import Pose, lane_pose
from elitelanes_jax.drive.rides import load_policy, make_rides
from experiments.navigation import speed as driving_speed
from experiments.search import devices

TOWN = np.array([[6, 7, 3], [12, 13, 9]])


@pytest.mark.slow
def test_the_speed_is_measured(capsys):
    assert driving_speed.main(["--quick"]) == 0
    said = capsys.readouterr().out
    assert all(f"| {name}" in said for name in ("RoadNav", "LaneDrive", "camera"))


@pytest.mark.slow
def test_devices_are_measured(capsys):
    assert devices.main(["--quick", "--repetitions", "1"]) == 0
    *_, table = capsys.readouterr().out.strip().split("\n\n")
    names = [line.split(" ")[1].rstrip(",") for line in table.splitlines()[2:]]
    environments = ["RoadNav", "LaneDrive", *["RoadTraffic"] * 3]
    assert names == [*["evaluations"] * 3, *environments, *["camera"] * 4, *["views"] * 3]
    with pytest.raises(SystemExit, match="2"):
        devices.main(["--repetitions", "0"])
    assert "--repetitions: expected a whole number, 1 or more, got '0'" in capsys.readouterr().err


@pytest.mark.slow
def test_the_driver_that_sees_its_camera_alone_stays_in_its_lane(drawn_tiles):
    pytest.importorskip("flax", reason="flax is not here", exc_type=ImportError)
    policy = load_policy(Path(__file__).parents[2] / "docs" / "examples" / "seeing_driver.py")
    own = make_rides(TOWN, 1, policy=policy, seconds=20, seed=1, tiles=drawn_tiles)
    end = int(own.steps[0])
    poses = Pose(*(part[0, :end] for part in (own.x, own.y, own.theta)))
    near = jax.vmap(lambda pose: lane_pose(TOWN, pose))(poses)
    assert np.abs(near.d).max() < 0.15 and bool(near.own_lane.all())
    assert np.hypot(np.diff(poses.x), np.diff(poses.y)).sum() > 5


@pytest.mark.slow
def test_a_policy_sees_varied_pictures_and_drives_within_its_limits():
    pytest.importorskip("flax", reason="flax is not here", exc_type=ImportError)
    from experiments.perception.gym_duckietown.policy import to_motion, vary

    plain = np.full((30, 40, 3), 60, np.uint8)
    plain[:10], plain[10:15] = (115, 210, 255), (86, 118, 72)  # the camera's sky and ground
    shown = [np.asarray(vary(jax.random.key(seed), plain)).astype(float) for seed in range(40)]
    assert (shown[0] == vary(jax.random.key(0), plain)).all()
    assert np.std([one[:10].mean() for one in shown]) > 20 and np.std([one[10:15].mean() for one in shown]) > 20
    assert np.median([one[15:].std(axis=(0, 1)).mean() for one in shown]) < 20  # the road stays plain
    found = [to_motion(np.array(action)) for action in ((-9.0, -9.0), (0.0, 0.5), (9.0, 9.0))]
    np.testing.assert_allclose(found, [(0.15, -4), (0.225, 2), (0.3, 4)])


@pytest.mark.slow
def test_a_policy_is_trained_and_its_weights_choose_actions(tmp_path, capsys):
    pytest.importorskip("flax", reason="flax is not here", exc_type=ImportError)
    from experiments.perception.gym_duckietown import nets, policy

    assert policy.main(["--out", str(tmp_path / "policy.npz"), "--updates", "1"]) == 0
    assert "update 1 of 1, reward of a step " in capsys.readouterr().out
    weights = nets.read_weights(tmp_path / "policy.npz", "policy")
    images = np.random.default_rng(0).integers(0, 256, (3, 120, 160, 3), np.uint8)
    actions = nets.choose_actions(weights, images)
    assert actions.shape == (3, 2) and np.abs(actions).max() <= 1
    with refused(tmp_path / "policy.npz", "those of another network", expected="train pose"):
        nets.read_weights(tmp_path / "policy.npz", "pose")
