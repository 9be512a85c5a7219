"""Records and interruptions travel between processes, and a process in which JAX cannot run says so."""

import os
import pickle
import re
import signal
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from copy import copy, deepcopy
from dataclasses import fields, is_dataclass
from functools import cache
from inspect import isclass
from multiprocessing import get_context

import cv2
import jax
import numpy as np
import pytest
from certified import same
from test_wrong_types import EVERY, arguments
from workers import interrupt, search

from elitelanes_jax import InputError, RoadMap, SearchInterrupted, drive, measure, rotate
from elitelanes_jax._util.engine import call_on_workers
from elitelanes_jax._util.errors import MissingPackageError
from elitelanes_jax.benchmark import Operators, OperatorSet
from elitelanes_jax.drive.interop import GymnaxEnv
from elitelanes_jax.formats import MapObject, make_plan
from elitelanes_jax.optimizers import Move, Optimizer, interop
from elitelanes_jax.tiles import load_objects

GRID = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8)

# They hold functions that are made for a problem, a run or a library. A worker makes its own.
OF_FUNCTIONS = (Move, Optimizer, Operators, OperatorSet, interop.EvosaxTask, GymnaxEnv)
RECORDS = [kind for kind in EVERY if isclass(kind) and kind not in OF_FUNCTIONS]


def parts_of(value):
    """The parts of a record or container; None for anything else."""
    if isinstance(value, BaseException):
        return [*value.args, getattr(value, "result", None)]
    if is_dataclass(value):
        return [getattr(value, field.name) for field in fields(value)]
    if isinstance(value, dict):
        return [*value.keys(), *value.values()]
    return value if isinstance(value, list | tuple) else None


@cache
def records():
    """A record of each public type, by type."""
    found = {}

    def collect(value):
        if type(value).__module__.startswith("elitelanes_jax"):
            found.setdefault(type(value), value)
        for part in parts_of(value) or ():
            collect(part)

    key, given = jax.random.key(0), arguments()
    params = drive.LaneDriveParams(given["levels"])
    cone = MapObject("cone", 1.0, 1.0, 0.0, 0.1)
    collect(given)
    collect(SearchInterrupted("stopped", search))
    collect(drive.LaneDrive.step(key, given["state"], np.zeros(2, np.float32), params))
    collect([params, load_objects(), make_plan(RoadMap(GRID, objects=(cone,)))])
    collect(drive.make_scenes([RoadMap(GRID)]))
    collect(drive.RoadTrafficParams(drive.make_traffic_levels([GRID]), robots=2))
    collect([InputError("wrong", "more"), MissingPackageError("missing", "", "pip install it")])
    for kind in RECORDS:
        if kind not in found:
            # The others have defaults, or hold arrays alone.
            collect(kind(*[np.arange(3)] * len(getattr(kind, "_fields", ()))))
    return found


def check_equal(one, other):
    assert type(one) is type(other)
    if (parts := parts_of(one)) is not None:
        for part, copied in zip(parts, parts_of(other), strict=True):
            check_equal(part, copied)
    elif isinstance(one, jax.Array) and jax.numpy.issubdtype(one.dtype, jax.dtypes.prng_key):
        assert (one == other).all()
    elif isinstance(one, jax.Array | np.ndarray | str | int | float | bytes):
        np.testing.assert_array_equal(one, other)


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__name__)
def test_records_are_pickled_and_copied(kind):
    record = records()[kind]
    for copied in (pickle.loads(pickle.dumps(record)), copy(record), deepcopy(record)):
        check_equal(record, copied)


def test_records_of_functions_are_copied():
    for name in ("move", "optimizer"):
        record = arguments()[name]
        assert copy(record) == deepcopy(record) == record


def test_an_interruption_in_a_worker_reaches_its_parent_with_the_result():
    stops = pytest.raises(SearchInterrupted, match="^a search was interrupted$")
    with stops as stopped, ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        pool.submit(interrupt).result()
    same(stopped.value.result, search())


def in_a_fork(function):
    """What a function returns or raises in a forked process, as text; "" if it takes half a minute."""
    read, write = os.pipe()
    with warnings.catch_warnings(action="ignore"):  # of Python and JAX about threads
        child = os.fork()
    if not child:
        signal.alarm(30)
        try:
            text = repr(function())
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        os.write(write, text.encode())
        os._exit(0)
    os.close(write)
    os.waitpid(child, 0)
    with os.fdopen(read) as pipe:
        return pipe.read()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no such processes")
def test_after_a_fork_what_needs_jax_says_so_in_one_line():
    measure(GRID)  # JAX has started
    for function in (lambda: measure(GRID), lambda: jax.jit(measure)(GRID), search, on_a_worker):
        said = in_a_fork(function)
        assert re.match("InputError: (worker .+: )?process: expected a process in which JAX can run, got a fork", said)
        assert "spawn" in said and "\n" not in said
    assert in_a_fork(lambda: rotate(RoadMap(GRID).codes).tolist()) == str(rotate(GRID).tolist())


def on_a_worker():
    """Calls a function that does not need JAX, as the drawing of a dataset."""
    return list(call_on_workers(ThreadPoolExecutor(1), len, ["ab"]))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no such processes")
def test_opencv_works_after_a_fork():
    picture = np.zeros((2000, 2000, 3), np.uint8)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        cv2.warpPerspective(picture, np.eye(3), (2000, 2000))  # OpenCV has started its threads
        assert in_a_fork(lambda: cv2.setNumThreads(1)) == "None"
        assert in_a_fork(cv2.getNumThreads) == "2" and cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(threads)
