"""More devices than one: the same results, bit for bit."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from threading import Barrier

import chex
import jax
import numpy as np
import pytest
from certified import evolve
from compiled_programs import forget_programs
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from elitelanes_jax import use_cores
from elitelanes_jax._util import threads
from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax.cli.main import make_parser
from elitelanes_jax.search._devices import choose_devices, device_of_each_part
from elitelanes_jax.search._programs import Programs, cut, join

CPU = jax.devices("cpu")[0]
advance = Programs.advance_parts

PROGRAM = """
import chex
import jax
from elitelanes_jax import evolve

keys, there = jax.random.split(jax.random.key(1), 3), jax.local_devices()
assert len(there) == 2
one, *others = (evolve(keys, (5, 6), preset="paper", generations=20, devices=some) for some in (1, there, there[1:]))
for other in others:
    chex.assert_trees_all_equal((other.elites, other.state), (one.elites, one.state))
print("done")
"""


@pytest.mark.slow
def test_seeds_spread_over_devices():
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    ran = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=False)
    assert ran.stdout == "done\n", ran.stderr[-2000:]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ea", "map-elites"])
def test_seeds_are_the_same_on_any_number_of_devices_stopped_and_continued_on_others(method):
    run = partial(evolve, jax.random.split(jax.random.key(3), 7), (5, 6), method=method, preset="paper", fill=False)
    one, *others = (run(generations=12, devices=devices) for devices in (1, 2, [CPU] * 7))
    for other in others:
        chex.assert_trees_all_equal((other.elites, other.state), (one.elites, one.state))
        chex.assert_trees_all_equal(other.history[:4], one.history[:4])
    half = run(generations=5, devices=2)
    rest = run(generations=7, devices=7, state=half.state)
    chex.assert_trees_all_equal((rest.elites, rest.state), (one.elites, one.state))


@pytest.mark.slow
def test_many_seeds_of_a_processor_run_in_small_parts(monkeypatch):
    run = partial(evolve, 0, (5, 6), seeds=9, method="ea", preset="paper", generations=3)
    whole = run(devices=1)
    monkeypatch.setattr("elitelanes_jax.search._devices._MOST_ROWS", 2)
    forget_programs()
    rows = []
    monkeypatch.setattr(
        Programs, "advance_parts", lambda *given: rows.extend(len(keys) for keys in given[2]) or advance(*given)
    )
    for devices, parts in ((1, [2] * 5), (2, [2] * 5), (4, [2] * 5), (9, [1] * 9)):
        rows.clear()
        found = run(devices=devices)
        assert rows == parts
        chex.assert_trees_all_equal((found.elites, found.state), (whole.elites, whole.state))


@pytest.mark.slow
def test_keys_that_depend_on_those_beside_them_stay_together():
    """The bits of other kinds of keys depend on the batch: on several devices they would not be those on one."""
    run = partial(evolve, jax.random.split(jax.random.key(3, impl="rbg"), 3), (5, 6), method="ea", preset="paper")
    one, other = (run(generations=5, devices=devices).elites for devices in (1, 3))
    chex.assert_trees_all_equal(one, other)


@given(rows=st.integers(1, 12), count=st.integers(1, 15))
def test_parts_have_one_size_and_make_the_whole(rows, count):
    tree = {"numbers": np.arange(rows * 2).reshape(rows, 2), "flags": np.arange(rows) % 3 == 0}
    parts = cut(tree, device_of_each_part([CPU] * count, rows))
    assert len({len(part["flags"]) for part in parts}) == 1
    assert len(parts) <= min(rows, count)
    assert len(parts[0]["flags"]) == -(-rows // count)  # as short as can be
    chex.assert_trees_all_equal(join(parts, rows), tree)


def test_parts_of_keys():
    keys = jax.random.split(jax.random.key(1), 5)
    parts = cut((keys, np.arange(5)), [CPU] * 3)
    assert [part[1].tolist() for part in parts] == [[0, 1], [2, 3], [4, 4]]
    assert (join(parts, 5)[0] == keys).all()


def test_calls_run_at_once_and_return_in_order():
    barrier = Barrier(3)

    def call(number):
        barrier.wait(10)  # breaks if any of them waits for another to end
        time.sleep(0.01 * (3 - number))
        return number

    assert side_by_side([partial(call, number) for number in range(3)]) == [0, 1, 2]


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_errors_and_interruptions_come_when_all_have_ended_or_are_left():
    ended = []

    def fail(at_work):
        at_work.wait(10)
        raise MemoryError("no more")

    def work(at_work):
        at_work.wait(10)
        time.sleep(0.2)
        ended.append(None)

    def interrupt(at_work):
        at_work.wait(10)
        signal.raise_signal(signal.SIGINT)

    def call(*functions, **options):
        at_work = Barrier(len(functions))
        side_by_side([partial(function, at_work) for function in functions], **options)

    with pytest.raises(MemoryError, match="no more"):
        call(work, fail)
    assert len(ended) == 1
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # under nohup it is ignored
    try:
        with pytest.raises(KeyboardInterrupt):
            call(work, interrupt, work)
        assert len(ended) == 3
        with pytest.raises(KeyboardInterrupt):
            call(work, interrupt, wait=False)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(ended) == 3


def test_devices_are_cores_by_default():
    assert choose_devices() == [CPU] * threads.count_cores()
    assert choose_devices(3) == choose_devices([CPU] * 3) == [CPU] * 3


def test_fewer_cores_on_request(monkeypatch):
    monkeypatch.setattr(threads, "_limit", None)  # put back after the test
    there = choose_devices()
    make_parser().parse_args(["generate", "--cores", "1", "--out", "maps"])
    assert choose_devices() == [CPU]
    use_cores(2**20)  # there are fewer
    assert choose_devices() == there
    with refused("count", "0"):
        use_cores(0)


@pytest.mark.parametrize("wrong", [0, -1, 1.5, True, "cpu", [], ["cpu"]])
def test_wrong_devices_are_refused(wrong, any_types):
    with refused("devices", repr(wrong), expected="JAX's devices"):
        evolve(devices=wrong)
