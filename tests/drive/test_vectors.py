"""Batches in the interfaces of Gymnasium, Stable-Baselines3 and PufferLib, checked by the libraries that are there."""

import re
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from driving_oracle import drawn_maps
from refusals import refused

from elitelanes_jax import load_tiles
from elitelanes_jax.drive import (
    Camera,
    LaneDrive,
    LaneDriveParams,
    RoadNav,
    RoadNavParams,
    RoadTraffic,
    RoadTrafficParams,
    make_levels,
    make_sight,
    make_traffic_levels,
)
from elitelanes_jax.drive._batch import Batch
from elitelanes_jax.drive.interop import (
    GymnaxEnv,
    gymnasium_env,
    gymnasium_vector_env,
    jaxmarl_env,
    pettingzoo_env,
    puffer_env,
    sb3_vec_env,
)

# Other libraries' warnings are theirs.
pytestmark = pytest.mark.filterwarnings("default")

LEVELS = make_levels(jax.random.key(2), drawn_maps(1, 16, (4, 5), fill=True))


@pytest.fixture(scope="module")
def made():
    sight = make_sight(load_tiles(), Camera(rows=36, columns=48, noise=2.0), tile_px=16)
    return {
        "road-nav": (RoadNav, RoadNavParams(LEVELS, limit=6, window=3)),
        "lane-drive": (LaneDrive, LaneDriveParams(LEVELS, limit=20, task="lane")),
        "camera": (LaneDrive, LaneDriveParams(LEVELS, limit=9, observe="camera", sight=sight)),
    }


NAMES = ("road-nav", "lane-drive", "camera")


def equal(ours, theirs):
    """Compares observations or infos of two libraries, whose dtypes and masks are part of them."""
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs)
        for name in theirs:
            equal(ours[name], theirs[name])
    elif theirs is None:
        assert ours is None
    elif theirs.dtype == np.dtype(object):
        for one, other in zip(ours, theirs, strict=True):
            equal(one, other)
    else:
        np.testing.assert_array_equal(ours, theirs, strict=True)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_has_the_results_of_its_own_vector_of_single_environments(made, name, mode):
    gymnasium = pytest.importorskip("gymnasium")
    chosen, envs = made[name], 2 if name == "camera" else 5
    mode = gymnasium.vector.AutoresetMode(mode)
    ours = gymnasium_vector_env(*chosen, gymnasium, envs=envs, autoreset_mode=mode)
    makers = [lambda: gymnasium_env(*chosen, gymnasium)] * envs
    theirs = gymnasium.vector.SyncVectorEnv(makers, autoreset_mode=mode)
    assert isinstance(ours, gymnasium.vector.VectorEnv) and ours.metadata["autoreset_mode"] == mode
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    equal(ours.reset(seed=3)[0], theirs.reset(seed=3)[0])
    ours.action_space.seed(1)
    ends = 0
    for _ in range(60):
        actions = ours.action_space.sample()
        (seen, reward, *flags, infos), (expected, earned, *ended, told) = ours.step(actions), theirs.step(actions)
        assert seen in ours.observation_space and not np.shares_memory(seen, ours.next_observations)
        equal(seen, expected)
        np.testing.assert_array_equal(reward, earned)
        np.testing.assert_array_equal(flags, ended)
        equal(infos, told)
        over = np.logical_or(*ended)
        ends += over.sum()
        if "final_obs" in infos:
            for index in np.flatnonzero(over):
                np.testing.assert_array_equal(ours.next_observations[index], infos["final_obs"][index])
                assert not np.shares_memory(ours.next_observations, infos["final_obs"][index])
        if mode == gymnasium.vector.AutoresetMode.DISABLED and over.any():
            with refused("step", "none", expected="episodes"):
                ours.step(actions)
            equal(*(vector.reset(options={"reset_mask": over.copy()})[0] for vector in (ours, theirs)))
    assert ends > 5
    equal(ours.reset(seed=[4] * envs)[0], theirs.reset(seed=[4] * envs)[0])
    ours.close()
    assert ours.closed


def test_wrappers_of_gymnasium_take_it(made):
    gymnasium = pytest.importorskip("gymnasium")
    wrappers = gymnasium.wrappers.vector
    vector = gymnasium_vector_env(
        *made["lane-drive"], gymnasium, envs=4, render=lambda state: np.zeros((2, 2, 3), "u1")
    )
    with refused("render", "none", expected="a reset"):
        vector.render()
    vector = wrappers.RecordEpisodeStatistics(wrappers.NormalizeReward(wrappers.NormalizeObservation(vector)))
    vector.reset(seed=0)
    assert len(vector.render()) == 4
    lengths = set()
    for _ in range(45):
        *_, infos = vector.step(vector.action_space.sample())
        lengths |= set(infos.get("episode", {"l": []})["l"])
    assert 20 in lengths


@pytest.mark.parametrize("name", NAMES)
def test_stable_baselines3_trains_on_it(made, name):
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    import gymnasium
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.vec_env import VecMonitor

    chosen = made[name]
    check_env(gymnasium_env(*chosen, gymnasium))
    vector = sb3_vec_env(*chosen, stable_baselines3, envs=3)
    alone = [gymnasium_env(*chosen, gymnasium) for _ in range(3)]
    vector.seed(5)
    expected = [env.reset(seed=5 + index)[0] for index, env in enumerate(alone)]
    channels = (lambda seen: np.moveaxis(seen, -1, 0)) if name == "camera" else np.asarray
    np.testing.assert_array_equal(vector.reset(), [channels(seen) for seen in expected])
    for _ in range(40):
        actions = np.array([vector.action_space.sample() for _ in range(3)])
        seen, rewards, over, infos = vector.step(actions)
        for index, env in enumerate(alone):
            after, reward, terminated, truncated, metrics = env.step(actions[index])
            assert rewards[index] == reward and over[index] == (terminated or truncated)
            if over[index]:
                np.testing.assert_array_equal(infos[index]["terminal_observation"], channels(after))
                assert infos[index]["TimeLimit.truncated"] == truncated
                assert infos[index]["is_success"] == metrics["success"]
                after, _ = env.reset()
            else:
                assert infos[index] == {}
            np.testing.assert_array_equal(seen[index], channels(after))
            assert vector.metrics["success"][index] == metrics["success"]
    assert vector.env_is_wrapped(gymnasium.Wrapper) == [False] * 3
    assert vector.get_attr("params", [1]) == [chosen[1]] and not vector.has_attr("nothing")
    with refused("method_name", "fly"):
        vector.env_method("fly")
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*not writable.*")
        policy = "CnnPolicy" if name == "camera" else "MlpPolicy"
        model = stable_baselines3.PPO(policy, VecMonitor(vector), n_steps=16, batch_size=16, n_epochs=1, seed=0)
        model.learn(96)
    assert len(model.ep_info_buffer) and len(model.ep_success_buffer)


@pytest.mark.parametrize("name", NAMES)
def test_pufferlib_steps_it(made, name):
    pufferlib = pytest.importorskip("pufferlib")
    vectors = pytest.importorskip("pufferlib.vector")
    environment, params = made[name]
    puffer = vectors.make(
        puffer_env,
        env_args=[environment, params, pufferlib],
        env_kwargs={"envs": 3},
        num_envs=2,
        backend=vectors.Serial,
    )
    alone = puffer_env(environment, params, pufferlib, envs=6)
    seen, _ = puffer.reset(seed=3)
    assert puffer.num_agents == 6 and seen in puffer.observation_space
    np.testing.assert_array_equal(seen[:3], alone.reset(seed=3)[0][:3])
    told = []
    for _ in range(40):
        actions = puffer.action_space.sample()
        seen, rewards, terminals, truncations, infos = puffer.step(actions)
        expected = alone.step(actions)
        for ours, theirs in zip((seen, rewards, terminals, truncations), expected[:4], strict=True):
            np.testing.assert_array_equal(ours[:3], theirs[:3])
        told += infos
    assert told and all(0 <= info["success"] <= 1 for info in told)
    puffer.close()


def fake_modules():
    """What our wrappers need of the other libraries."""
    taker = type("Taker", (), {"__init__": lambda self, *anything: None})
    spaces = SimpleNamespace(Discrete=lambda number: number, Box=lambda *limits: limits)
    vector = SimpleNamespace(
        AutoresetMode=str,
        VectorEnv=type("VectorEnv", (), {"reset": lambda self, seed: None}),
        utils=SimpleNamespace(batch_space=lambda space, envs: space),
    )
    env = type("Env", (), {"reset": lambda self, seed: None})
    gymnasium = SimpleNamespace(Env=env, spaces=spaces, vector=vector)

    class VecEnv:
        def __init__(self, envs, *anything):
            self.num_envs, self._seeds, self._options = envs, [None] * envs, [{}] * envs

        def set_options(self, options):
            self._options = [options] * self.num_envs if isinstance(options, dict) else options

        def _reset_seeds(self):
            self._seeds = [None] * self.num_envs

        def _reset_options(self):
            self._options = [{}] * self.num_envs

        def _get_indices(self, indices):
            return range(self.num_envs) if indices is None else indices

    base = SimpleNamespace(VecEnv=VecEnv, spaces=spaces)
    return SimpleNamespace(
        gymnasium=gymnasium,
        stable_baselines3=SimpleNamespace(
            common=SimpleNamespace(vec_env=SimpleNamespace(base_vec_env=base, VecEnv=VecEnv))
        ),
        pufferlib=SimpleNamespace(PufferEnv=taker, emulation=SimpleNamespace(gymnasium=gymnasium)),
        spaces=spaces,
    )


def level_indices(env):
    """Returns for each environment the indices of the levels that it may be on, by its map."""
    grids = np.asarray(env.params.levels.grid)
    return [{*np.flatnonzero((grids == state.grid).all((1, 2)))} for state in env._batch.states("states")]


@pytest.fixture(params=["fake", "real"])
def libraries(request):
    if request.param == "fake":
        return fake_modules()
    modules = {name: pytest.importorskip(name) for name in ("gymnasium", "stable_baselines3")}
    return SimpleNamespace(**modules)


@pytest.mark.slow
def test_the_program_of_the_page_runs_in_workers_of_pufferlib(tmp_path):
    pytest.importorskip("pufferlib.vector")
    page = (Path(__file__).parents[2] / "docs" / "drive.md").read_text(encoding="utf-8")
    (program,) = [text for text in re.findall(r"```py\n(.*?)```", page, re.DOTALL) if "Multiprocessing" in text]
    for name, text, code, words in (
        ("spawned.py", program, 0, "(512, "),
        ("forked.py", program.replace('"spawn"', '"fork"'), 1, "InputError: Multiprocessing: expected workers "),
    ):
        (tmp_path / name).write_text(text)
        done = subprocess.run([sys.executable, name], cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert done.returncode == code and words in done.stdout + done.stderr, done.stderr


@pytest.mark.usefixtures("any_types")
def test_a_wrong_action_of_one_environment_has_no_axis_of_environments(libraries):
    for environment, make_params, wrong, got in (
        (RoadNav, RoadNavParams, [1], "int64 [1]"),
        (RoadNav, RoadNavParams, None, "object []"),
        (LaneDrive, LaneDriveParams, 1.5, "float64 []"),
    ):
        alone = gymnasium_env(environment, make_params(LEVELS), libraries.gymnasium)
        alone.reset(seed=0)
        with refused("action", got):
            alone.step(wrong)


@pytest.mark.usefixtures("any_types")
def test_a_curriculum_changes_levels(libraries):
    params, few = RoadNavParams(LEVELS, limit=6, window=3), jax.tree.map(lambda part: part[7:9], LEVELS)
    other = params.replace(levels=few)
    alone = gymnasium_env(RoadNav, params, libraries.gymnasium)
    vector = gymnasium_vector_env(RoadNav, params, libraries.gymnasium, envs=4)
    envs = sb3_vec_env(RoadNav, params, libraries.stable_baselines3, envs=4)
    for level in (3, 11):
        alone.reset(options={"level": level})
        vector.reset(options={"level": level})
        envs.set_options({"level": level})
        envs.reset()
        for env in (alone, vector, envs):
            assert all(level in found for found in level_indices(env))
    vector.reset(options={"level": [0, 4, 8, 12]})
    envs.set_options([{"level": level} for level in (0, 4, 8, 12)])
    envs.reset()
    for env in (vector, envs):
        assert all(level in found for level, found in zip((0, 4, 8, 12), level_indices(env), strict=True))

    alone.params = other
    vector.set_attr("params", other)
    envs.set_attr("params", other)
    assert alone.params is other and vector.get_attr("params") == (other,) * 4
    assert envs.get_attr("params") == [other] * 4
    for _ in range(3):
        # These resets draw levels, because options are for one reset.
        for env in (alone, vector, envs):
            env.reset()
            assert all(found for found in level_indices(env))
    with refused("level", "3"):
        alone.reset(options={"level": 3})


@pytest.mark.usefixtures("any_types")
def test_what_would_change_nothing_is_refused(libraries):
    params = RoadNavParams(LEVELS, limit=6, window=3)
    alone = gymnasium_env(RoadNav, params, libraries.gymnasium)
    vector = gymnasium_vector_env(RoadNav, params, libraries.gymnasium, envs=4)
    envs = sb3_vec_env(RoadNav, params, libraries.stable_baselines3, envs=4)
    fakes = fake_modules()
    puffer = puffer_env(RoadNav, params, fakes.pufferlib, envs=2)
    gymnax = GymnaxEnv(RoadNav, params, fakes.spaces)

    def sb3_reset(options):
        envs.set_options(options)
        try:
            envs.reset()
        finally:
            envs.reset()  # options that were refused are not refused again

    for call, subject, got, expected in (
        (lambda: alone.reset(options={"levl": 3}), "levl", "'levl'", "one of level"),
        (lambda: alone.reset(options={"reset_mask": 3}), "reset_mask", "'reset_mask'", "one of level"),
        *(
            (
                lambda reset=reset, level=level: reset({"level": level}),
                "level",
                repr(level),
                "0 to 15",
            )
            for reset in (
                lambda options: alone.reset(options=options),
                lambda options: vector.reset(options=options),
                sb3_reset,
            )
            for level in ("3x", "3", True, 3.0, 16)
        ),
        (lambda: vector.reset(options={"level": ["3", None, None, 1]}), "level", "'3'", "0 to 15"),
        (lambda: vector.reset(options={"seed": 3}), "seed", "'seed'", "one of level, reset_mask"),
        (lambda: vector.reset(options={"level": [1]}), "level", "[1]", "4 of them"),
        (lambda: sb3_reset({"levels": 3}), "levels", "'levels'", "one of level"),
        (lambda: envs.set_attr("limit", 4), "set_attr", "'limit'", "params"),
        (lambda: vector.set_attr("levels", 4), "set_attr", "'levels'", "params"),
        (lambda: envs.set_attr("params", params, [1]), "indices", "[1]", "all"),
        (lambda: vector.set_attr("params", [params, params.replace(limit=3)]), "set_attr", "2 of them", "one params"),
        (lambda: envs.set_attr("params", LEVELS), "params", "Level(...", "RoadNavParams"),
        (lambda: setattr(puffer, "params", None), "params", "None", "RoadNavParams"),
        (lambda: setattr(gymnax, "params", params), "params", "an attribute", "params of reset and step"),
        (lambda: setattr(gymnax, "limit", 3), "limit", "an attribute", "params of reset and step"),
        *(
            (lambda env=env: setattr(env, "levels", LEVELS), "levels", "an attribute", "env.params")
            for env in (alone, vector, envs, puffer)
        ),
        *(
            (lambda env=env, name=name: setattr(env, name, None), name, "None", "the environment has")
            for env, names in (
                (alone, ("action_space", "observation_space", "render_mode")),
                (vector, ("num_envs", "single_action_space", "observation_space", "render_mode", "autoreset_mode")),
                (envs, ("num_envs", "action_space", "observation_space", "render_mode")),
                (puffer, ("num_agents", "single_action_space", "single_observation_space")),
            )
            for name in names
        ),
        (lambda: setattr(gymnax, "num_actions", 7), "num_actions", "7", "3"),
    ):
        with refused(subject, got, expected):
            call()


def test_a_function_that_draws_no_picture_is_named(libraries):
    """Otherwise the picture would be an array with None in it."""
    params = RoadNavParams(LEVELS)
    for draw in (lambda state: None, lambda state: np.zeros((4, 4), np.uint8), lambda state: np.zeros((4, 4, 3))):
        alone = gymnasium_env(RoadNav, params, libraries.gymnasium, render=draw)
        vector = gymnasium_vector_env(RoadNav, params, libraries.gymnasium, envs=2, render=draw)
        for env in (alone, vector):
            env.reset(seed=0)
            with refused("render", expected="uint8 [H, W, 3]"):
                env.render()


def test_what_is_wrong_is_named():
    params = RoadNavParams(LEVELS)
    for wrap, subject, got in (
        (lambda: gymnasium_vector_env(RoadNav, params, None), "gymnasium", "None"),
        (lambda: sb3_vec_env(RoadNav, params, 3), "stable_baselines3", "3"),
        (lambda: puffer_env(RoadNav, params, None), "pufferlib", "None"),
    ):
        with refused(subject, got):
            wrap()


@pytest.mark.usefixtures("any_types")
def test_a_mode_of_gymnasium_is_no_function_that_draws():
    params, fakes = RoadNavParams(LEVELS), fake_modules()
    for wrap, module in (
        (gymnasium_env, fakes.gymnasium),
        (gymnasium_vector_env, fakes.gymnasium),
        (sb3_vec_env, fakes.stable_baselines3),
    ):
        with refused("render", "'human'"):
            wrap(RoadNav, params, module, render="human")


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("seed", ["3", 1.5, True, [3]])
def test_a_seed_of_pufferlib_is_a_whole_number(seed):
    env = puffer_env(RoadNav, RoadNavParams(LEVELS), fake_modules().pufferlib, envs=2)
    with refused("seed", repr(seed), expected="number"):
        env.reset(seed=seed)


@pytest.mark.usefixtures("any_types")
def test_workers_of_pufferlib_are_not_forked(monkeypatch):
    class Multiprocessing:
        def __init__(self, creator):
            self.driver_env = creator()

    pufferlib = fake_modules().pufferlib
    pufferlib.vector = SimpleNamespace(Multiprocessing=Multiprocessing)

    def create():
        return puffer_env(RoadNav, RoadNavParams(LEVELS), pufferlib, envs=2)

    monkeypatch.setattr("multiprocessing.get_start_method", lambda allow_none: "spawn")
    assert Multiprocessing(create).driver_env.num_agents == 2
    monkeypatch.setattr("multiprocessing.get_start_method", lambda allow_none: None)
    monkeypatch.setattr("multiprocessing.get_all_start_methods", lambda: ["fork", "spawn"])
    assert create().num_agents == 2
    with refused("Multiprocessing", "the start method fork, ..."):
        Multiprocessing(create)


def test_a_seed_may_be_a_small_number_of_numpy():
    gymnasium = pytest.importorskip("gymnasium")
    vector = gymnasium_vector_env(RoadNav, RoadNavParams(LEVELS), gymnasium, envs=3)
    expected, _ = vector.reset(seed=254)
    np.testing.assert_array_equal(vector.reset(seed=np.uint8(254))[0], expected)
    alone = gymnasium_env(RoadNav, RoadNavParams(LEVELS), gymnasium)
    np.testing.assert_array_equal(alone.reset(seed=np.uint8(254))[0], expected[0])
    with refused("seed", "-1"):
        alone.reset(seed=-1)
    with refused("seed", "-1"):
        vector.reset(seed=-1)


def test_what_gymnasium_does_not_take_is_named():
    gymnasium = pytest.importorskip("gymnasium")
    params = RoadNavParams(LEVELS)
    vector = gymnasium_vector_env(RoadNav, params, gymnasium, envs=2)
    motionless = LaneDrive._replace(action_size=0)
    for call, subject, got in (
        (
            lambda: gymnasium_vector_env(RoadNav, params, gymnasium, envs=0),
            "envs",
            "0",
        ),
        (
            lambda: vector.reset(options=["reset_mask"]),
            "options",
            "['reset_mask']",
        ),
        (
            lambda: gymnasium_vector_env(RoadNav, None, gymnasium),
            "params",
            "None",
        ),
        (
            lambda: gymnasium_vector_env(RoadNav, params, gymnasium, autoreset_mode="never"),
            "autoreset_mode",
            "'never'",
        ),
        (
            lambda: gymnasium_env(motionless, LaneDriveParams(LEVELS), gymnasium),
            "environment",
            "0",
        ),
        (
            lambda: vector.reset(options={"reset_mask": [True, False]}),
            "reset_mask",
            "[True, False]",
        ),
        (
            lambda: vector.reset(options={"reset_mask": np.zeros(2, bool)}),
            "reset_mask",
            "array([False, False])",
        ),
    ):
        with refused(subject, got):
            call()


@pytest.fixture(scope="module")
def traffic():
    levels = make_traffic_levels(drawn_maps(1, 3, (4, 5), fill=True))
    return RoadTraffic, RoadTrafficParams(levels, robots=5, limit=6)


def test_robots_that_share_a_town_are_rows_of_gymnasium(traffic):
    gymnasium = pytest.importorskip("gymnasium")
    vector = gymnasium_vector_env(*traffic, gymnasium, envs=3, render=lambda state: np.zeros((2, 2, 3), "u1"))
    assert vector.num_envs == 15 and vector.single_action_space == gymnasium.spaces.Discrete(4)
    seen, _ = vector.reset(seed=3, options={"level": 1})
    assert seen in vector.observation_space and len(vector.render()) == 3
    lengths = set()
    vector = gymnasium.wrappers.vector.RecordEpisodeStatistics(vector)
    vector.reset(seed=3)
    for _ in range(20):
        # The first four numbers of an observation are the actions that make sense.
        mask = (seen[:, :4] > 0).astype(np.int8)
        seen, *_, infos = vector.step(vector.action_space.sample(mask=tuple(mask)))
        lengths |= set(infos.get("episode", {"l": []})["l"])
    assert 6 in lengths
    with refused("environment", "one of many robots"):
        gymnasium_env(*traffic, gymnasium)


def test_stable_baselines3_trains_robots_that_share_a_town(traffic):
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    vector = sb3_vec_env(
        *traffic, stable_baselines3, envs=3, render=lambda state: np.full((2, 2, 3), state.level, "u1")
    )
    assert vector.num_envs == 15
    vector.set_options([{"level": index // 5} for index in range(15)])
    vector.reset()
    assert [int(picture[0, 0, 0]) for picture in vector.env_method("render", indices=[0, 4, 5, 14])] == [0, 0, 1, 2]
    model = stable_baselines3.PPO("MlpPolicy", vector, n_steps=8, batch_size=40, n_epochs=1, seed=0)
    model.learn(240)
    assert set(vector.metrics) == {"reached", "goals", "tiles", "gridlocked"}


def test_pufferlib_has_an_agent_for_each_robot(traffic):
    pufferlib = pytest.importorskip("pufferlib")
    vectors = pytest.importorskip("pufferlib.vector")
    puffer = vectors.make(
        puffer_env, env_args=[*traffic, pufferlib], env_kwargs={"envs": 3}, num_envs=2, backend=vectors.Serial
    )
    seen, _ = puffer.reset(seed=3)
    assert puffer.num_agents == 30 and seen in puffer.observation_space
    told = []
    for _ in range(14):
        told += puffer.step(puffer.action_space.sample())[4]
    assert told and all(info["tiles"] >= info["goals"] for info in told)


def test_pettingzoo_takes_it(traffic):
    pettingzoo = pytest.importorskip("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    def make():
        return pettingzoo_env(*traffic, pettingzoo, render=lambda state: np.full((2, 2, 3), state.level, "u1"))

    with pytest.warns(UserWarning, match="pettingzoo_env: expected the option level, got 'options'"):
        parallel_api_test(make(), num_cycles=50)
    parallel_seed_test(make)
    env, batch = make(), Batch(*traffic, 1, "Disabled")
    observations, infos = env.reset(seed=4, options={"level": 2})
    assert env.num_agents == 5 and env.render()[0, 0, 0] == 2
    np.testing.assert_array_equal(list(observations.values()), batch.reset([4] * 5, levels=[2] * 5))
    for _ in range(6):
        masks = {agent: info["action_mask"] for agent, info in infos.items()}
        actions = {agent: env.action_space(agent).sample(mask=masks[agent]) for agent in env.agents}
        observations, rewards, terminated, truncated, infos = env.step(actions)
        done = batch.step(list(actions.values()))
        np.testing.assert_array_equal(list(observations.values()), done.observation)
        assert list(rewards.values()) == done.reward.tolist()
        assert list(terminated.values()) == done.terminated.tolist()
        assert list(truncated.values()) == done.truncated.tolist()
        assert [info["goals"] for info in infos.values()] == done.metrics["goals"].tolist()
    assert not env.agents
    with refused("step", "none", expected="no robot drives"):
        env.step(actions)
    env.reset()
    with refused("actions", "{'robot_0': 1}", expected="robot_0 to robot_4"):
        env.step({"robot_0": 1})


@pytest.mark.usefixtures("any_types")
def test_jaxmarl_takes_it(traffic):
    jaxmarl = pytest.importorskip("jaxmarl")
    from jaxmarl.environments.multi_agent_env import MultiAgentEnv

    environment, params = traffic
    env = jaxmarl_env(*traffic, jaxmarl)
    assert isinstance(env, MultiAgentEnv) and env.num_agents == 5 and env.agents[4] == "agent_4"
    assert env.action_space("agent_0").n == 4 and env.name == "RoadTraffic"
    key, ends = jax.random.key(0), 0
    observations, state = env.reset(key)
    seen, expected = jax.jit(environment.reset)(key, params)
    step = jax.jit(environment.step)
    for number in range(20):
        assert observations["agent_3"].shape == env.observation_space("agent_3").shape
        available = env.get_avail_actions(state)
        np.testing.assert_array_equal(list(available.values()), seen.allowed)
        np.testing.assert_array_equal(env.get_obs(state)["agent_2"], observations["agent_2"])
        actions = {agent: jax.numpy.int32((number + index) % 4) for index, agent in enumerate(env.agents)}
        key = jax.random.key(number)
        # JaxMARL resets with the second half of the key, and steps with the first one.
        stepping, resetting = jax.random.split(key)
        observations, state, rewards, dones, infos = env.step(key, state, actions)
        done = step(stepping, expected, jax.numpy.stack(list(actions.values())), params)
        np.testing.assert_array_equal(list(rewards.values()), done.reward)
        over = bool(done.terminated | done.truncated)
        assert set(dones) == {*env.agents, "__all__"} and all(bool(end) == over for end in dones.values())
        assert {info.shape for info in infos.values()} == {(5,)}
        np.testing.assert_array_equal(infos["goals"], done.info.goals)
        seen, expected = environment.reset(resetting, params) if over else (done.observation, done.state)
        jax.tree.map(np.testing.assert_array_equal, state, expected)
        ends += over
    assert ends > 2
    with refused("params", "an attribute", expected="new environment"):
        env.params = params
    with refused("environment", "one of one robot"):
        jaxmarl_env(RoadNav, RoadNavParams(LEVELS), jaxmarl)
