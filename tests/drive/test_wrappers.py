"""The environments in other libraries' interfaces; with these installed, in their own loops."""

from copy import deepcopy
from types import ModuleType, SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from driving_oracle import drawn_maps
from refusals import refused

from elitelanes_jax import load_tiles
from elitelanes_jax.drive import (
    Camera,
    LaneDrive,
    LaneDriveParams,
    Pose,
    RoadNav,
    RoadNavParams,
    auto_replay,
    auto_reset,
    look,
    make_levels,
    make_sight,
)
from elitelanes_jax.drive._batch import Batch
from elitelanes_jax.drive._batch_programs import NEXT_STEP
from elitelanes_jax.drive._flat import flatten
from elitelanes_jax.drive.interop import GymnaxEnv, gymnasium_env

# Other libraries' warnings are theirs.
pytestmark = pytest.mark.filterwarnings("default")

SPACES = SimpleNamespace(Discrete=lambda n: ("discrete", n), Box=lambda *limits: ("box", *limits))


@pytest.fixture(scope="module")
def levels():
    return make_levels(jax.random.key(2), drawn_maps(1, 16, (4, 5), fill=True))


@pytest.fixture(scope="module")
def params(levels):
    return RoadNavParams(levels, limit=6, window=3)


@pytest.fixture(scope="module")
def seeing(levels):
    sight = make_sight(load_tiles(), Camera(rows=12, columns=16, noise=2.0), tile_px=16)
    return LaneDriveParams(levels, limit=20, observe="camera", sight=sight)


@pytest.mark.parametrize("restarting", [auto_reset, auto_replay])
def test_an_environment_that_begins_episodes_itself_is_refused(restarting, params):
    environment = restarting(RoadNav)
    for wrap in (
        lambda: GymnaxEnv(environment, params, SPACES),
        lambda: Batch(environment, params, 2, NEXT_STEP),
        lambda: auto_reset(environment),
        lambda: auto_replay(environment),
    ):
        with refused("environment", "one of auto_reset or auto_replay"):
            wrap()


@pytest.mark.slow
def test_the_camera_is_an_observation_of_all_wrappers(seeing):
    env = GymnaxEnv(LaneDrive, seeing, SPACES, values=5)
    assert env.observation_space() == ("box", 0, 255, (12, 16, 3), np.uint8)
    key = jax.random.key(0)
    image, state = jax.jit(env.reset)(key)
    assert image.dtype == jnp.uint8 and image.shape == (12, 16, 3)
    np.testing.assert_array_equal(image, jax.jit(look)(state.pose, state.grid, seeing.sight).image)
    action = jnp.array([0.3, 0.5])
    moved, after, *_, info = jax.jit(env.step)(key, state, action)
    assert (moved != image).any() and (moved == info["final_observation"]).all()
    np.testing.assert_array_equal(moved, LaneDrive.observe(after, seeing).image)


def test_gymnax_has_our_values_as_vectors(params):
    key = jax.random.key(0)
    expected = jax.jit(auto_reset(RoadNav).step)
    five = GymnaxEnv(RoadNav, params, SPACES, values=5)
    state = jax.eval_shape(five.reset, key, params)[1]
    assert [part.dtype for part in jax.eval_shape(five.step, key, state, 0, params)[2:4]] == [jnp.float32, bool]
    env = GymnaxEnv(RoadNav, params, SPACES)
    assert env.name == "RoadNav" and env.num_actions == 3 and env.default_params.max_steps_in_episode == 6
    assert env.action_space() == ("discrete", 3)
    assert env.observation_space(params) == ("box", -np.inf, np.inf, (3 + 4 * 9 + 3,))
    observation, state = jax.jit(env.reset)(key, params)
    step = jax.jit(env.step)
    params = params.replace(limit=4)  # The options of a step are those that it gets.
    cut = False
    for number in range(7):
        ours = expected(jax.random.fold_in(key, number), state, number % 3, params)
        observation, state, reward, *ended, info = step(jax.random.fold_in(key, number), state, number % 3, params)
        np.testing.assert_array_equal(observation, flatten(ours.observation))
        np.testing.assert_array_equal(info["final_observation"], flatten(ours.reached))
        assert reward == ours.reward and len(ended) == 2
        assert info["truncated"] == ours.truncated and bool(info["discount"]) != ours.terminated
        assert any(ended) == (ours.terminated | ours.truncated)
        cut |= bool(any(ended))
    assert cut


def test_a_vector_has_codes_as_bits():
    seen = (jnp.array([[9, 4]], jnp.int8), jnp.array([True]), jnp.float32(0.5), None)
    assert flatten(seen).tolist() == [1, 0, 0, 1, 0, 1, 0, 0, 1, 0.5]


@pytest.mark.parametrize("environment", ["road-nav", "lane-drive", "camera"])
def test_gymnasium_accepts_them(environment, params, levels, seeing):
    gymnasium = pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    given = {
        "road-nav": (RoadNav, params),
        "lane-drive": (LaneDrive, LaneDriveParams(levels, limit=20)),
        "camera": (LaneDrive, seeing),
    }[environment]

    def render(state):
        pose = getattr(state, "pose", Pose(1.0, 1.0, 0.0))
        return look(pose, state.grid, seeing.sight).image

    alone = gymnasium_env(*given, gymnasium, render=render)
    check_env(alone, skip_render_check=True)
    with refused("render", "none", expected="a reset"):
        gymnasium_env(*given, gymnasium, render=render).render()
    with refused("step", "none", expected="a reset"):
        gymnasium_env(*given, gymnasium).step(alone.action_space.sample())
    alone.reset(seed=1)
    assert alone.render_mode == "rgb_array" and alone.render().dtype == np.uint8


def test_what_is_wrong_is_named(params):
    for wrap, subject, got, expected in (
        (lambda: GymnaxEnv(RoadNav, params, None), "spaces", "None", ""),
        (
            lambda: GymnaxEnv(RoadNav, None, SPACES),
            "params",
            "None",
            "LaneDriveParams",
        ),
        (lambda: GymnaxEnv(RoadNav, params, SPACES, values=7), "values", "7", ""),
        (lambda: gymnasium_env(RoadNav, params, None), "gymnasium", "None", ""),
    ):
        with refused(subject, got, expected):
            wrap()


def test_they_can_be_copied(params, seeing):
    # Rejax copies environments; a module, such as ``gymnax.environments.spaces``, cannot be copied.
    for environment, settings in ((RoadNav, params), (LaneDrive, seeing)):
        spaces = ModuleType("spaces")
        spaces.Discrete, spaces.Box = SPACES.Discrete, SPACES.Box
        assert deepcopy(GymnaxEnv(environment, settings, spaces)).action_space()


class _Env:
    """What `gymnasium.Env` has that ours calls."""

    def reset(self, *, seed=None):
        self.seed = seed


@pytest.mark.usefixtures("any_types")
def test_a_deep_copy_has_a_state_of_its_own(params):
    """A search such as MCTS copies an environment, and steps the copy."""
    env = gymnasium_env(RoadNav, params, SimpleNamespace(Env=_Env, spaces=SPACES))
    env.reset(seed=3)
    expected = [env.step(action)[0] for action in (0, 1, 2, 1)]
    env.reset(seed=np.int64(3))
    assert type(env.seed) is int and env.seed == 3
    env.step(0)
    copied = deepcopy(env)
    for stepped in (copied, env):
        for action, observation in zip((1, 2, 1), expected[1:], strict=True):
            np.testing.assert_array_equal(stepped.step(action)[0], observation)


@pytest.mark.slow
@pytest.mark.usefixtures("standard")  # rejax adds arrays of several dtypes
def test_rejax_learns_on_it(levels):
    pytest.importorskip("rejax")
    from gymnax.environments import spaces
    from rejax import PPO

    params = RoadNavParams(levels, limit=20)
    env = GymnaxEnv(RoadNav, params, spaces, values=5)
    settings = {"total_timesteps": 8192, "eval_freq": 4096, "num_envs": 16, "num_steps": 64}
    algorithm = PPO.create(env=env, env_params=params, **settings)
    _, (lengths, returns) = jax.jit(algorithm.train)(jax.random.key(0))
    assert np.isfinite(returns).all() and (lengths <= 20).all() and returns[-1].mean() > returns[0].mean()
