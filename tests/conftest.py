"""What several tests share."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from elitelanes_jax.tilesets import TileSet, load_tiles

# Examples are few enough for CI and the same every time; compilation of a new shape may take its time.
settings.register_profile("ci", max_examples=100, deadline=None, derandomize=True)
settings.load_profile("ci")

REAL_TILES = Path(__file__).parents[2] / "shared" / "real_tiles"


def grids():
    """Hypothesis: grids of any codes, of a few shapes (each is compiled once)."""
    shapes = st.sampled_from([(2, 2), (2, 5), (5, 2), (3, 4), (6, 6)])
    return shapes.flatmap(lambda shape: hnp.arrays(np.int8, shape, elements=st.integers(0, 15)))


@pytest.fixture(scope="session")
def drawn_tiles() -> TileSet:
    return load_tiles()


@pytest.fixture(scope="session")
def real_tiles() -> TileSet:
    if not REAL_TILES.is_dir():
        pytest.skip("the photographed tiles are not here")
    return load_tiles(REAL_TILES)


@pytest.fixture(scope="module")
def own_compile_cache(tmp_path_factory) -> Iterator[None]:
    """Programs that commands compile go to a folder of the tests' own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield
    jax.config.update("jax_compilation_cache_dir", None)


@pytest.fixture(scope="module", autouse=True)
def compiled_programs_are_let_go() -> Iterator[None]:
    """One process that keeps the programs of all modules runs out of memory mappings, and crashes."""
    yield
    jax.clear_caches()


_compiled: list[str] = []


def _count(event: str, _: float, **__: object) -> None:
    if event == "/jax/core/compile/backend_compile_duration":
        _compiled.append(event)


jax.monitoring.register_event_duration_secs_listener(_count)


@contextmanager
def compilations() -> Iterator[list[str]]:
    """A list that has an entry for each program compiled within the block."""
    _compiled.clear()
    yield _compiled
