"""Fixtures and helpers that several tests share."""

import gc
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import jax
import jaxtyping
from compiled_programs import QUICK_FLAGS, free_programs

# The programs that commands compile go to a folder of this session, which all workers share. So each is compiled once.
# Slow proofs compile as users do.
if "PYTEST_XDIST_WORKER" not in os.environ:
    cache = tempfile.TemporaryDirectory(prefix="elitelanes-tests-", ignore_cleanup_errors=True)
    os.environ["XDG_CACHE_HOME"] = cache.name
    if "slow" not in sys.argv:
        os.environ["XLA_FLAGS"] = QUICK_FLAGS
        os.environ["NUMBA_OPT"] = "1"  # a quarter less time than at 3, for programs that run once
    os.environ["MALLOC_ARENA_MAX"] = "2"  # the compiler's threads would each keep memory of their own

# Tracing makes and drops many objects: to look for circles among them so often takes a twentieth of the time.
gc.set_threshold(100_000, 20, 20)

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from elitelanes_jax.tiles.tileset import TileSet, default_tiles, load_tiles

# Examples are the same every time; compilation of a new shape may take its time. Slow proofs draw twenty times as many.
settings.register_profile("ci", max_examples=50, deadline=None, derandomize=True)
settings.register_profile("proof", max_examples=1000, deadline=None, derandomize=True)


def pytest_configure(config: pytest.Config) -> None:
    settings.load_profile("proof" if config.option.markexpr == "slow" else "ci")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Properties of random examples are slow proofs too, with the examples of their profile."""
    if config.option.markexpr == "slow":
        for item in items:
            if getattr(getattr(item, "obj", None), "is_hypothesis_test", False):
                item.add_marker(pytest.mark.slow)


REAL_TILES = Path(__file__).parents[2] / "shared" / "real_tiles"


SHAPES = [(2, 2), (2, 5), (5, 2), (3, 4), (6, 6)]
ALL_SHAPES = [*SHAPES, (1, 1), (1, 4), (5, 1)]


def grids(shapes=SHAPES):
    """Hypothesis: grids of any codes. Each shape is compiled once, so that there are few."""
    return st.sampled_from(shapes).flatmap(lambda shape: hnp.arrays(np.int8, shape, elements=st.integers(0, 15)))


# Rooms whose tests run under JAX's strict settings, so that no shape and no dtype of ours depends on a promotion.
STRICT = ("network", "problem", "optimizers", "drive")


@pytest.fixture(autouse=True)
def strict(request: pytest.FixtureRequest) -> Iterator[None]:
    if request.path.parent.name in STRICT:
        with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
            yield
    else:
        yield


@pytest.fixture
def standard() -> Iterator[None]:
    """Allows promotions in a strict room: for tests that compute as users and other libraries do."""
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        yield


@pytest.fixture
def any_types() -> Iterator[None]:
    """Turns the check of types off: for tests of wrong arguments, and for tests that call Python functions often."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def drawn_tiles() -> TileSet:
    return load_tiles()


@pytest.fixture(scope="session")
def real_tiles() -> TileSet:
    if not REAL_TILES.is_dir():
        pytest.skip("the photographed tiles are not here")
    return load_tiles(REAL_TILES)


@pytest.fixture
def folder(tmp_path):
    """A copy of four drawn tiles that may be spoilt."""
    for name in ("turn_1", "straight_1", "crossing3_1", "crossing4_1"):
        shutil.copytree(default_tiles() / name, tmp_path / "tiles" / name)
    return tmp_path / "tiles"


@pytest.fixture
def small_files_only():
    """The system refuses files over a limit as it refuses those that a full disk has no room for."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit(size):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))

    yield limit
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module", autouse=True)
def compiled_programs_are_freed() -> Iterator[None]:
    """One process that keeps the programs of all modules runs out of memory mappings, and crashes."""
    yield
    free_programs()
