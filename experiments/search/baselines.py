"""Baselines for the kernels: the same fitness by NumPy and NetworkX, and by Tarjan's depth-first search in C++."""

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.search.check_archive import rescore

__all__ = ["cpp_fitness", "networkx_fitness"]


def networkx_fitness(grids: NDArray[np.int8]) -> NDArray[np.int64]:
    """Computes the paper's fitness of grids ``[B, H, W]``, one after another."""
    return np.array([rescore(grid).fitness for grid in grids])


def cpp_fitness() -> Callable[[NDArray[np.int8]], NDArray[np.int32]] | None:
    """Compiles `tarjan.cpp`, which computes the paper's fitness of grids ``[B, H, W]``; None without a compiler."""
    compiler = shutil.which(os.environ.get("CXX", "c++"))
    if compiler is None:
        return None
    source = Path(__file__).with_name("tarjan.cpp")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "tarjan.so"
        command = [compiler, "-O3", "-march=native", "-std=c++17", "-shared", "-fPIC", str(source), "-o", str(library)]
        subprocess.run(command, check=True)
        call = ctypes.CDLL(str(library)).fitness  # stays loaded without its file

    def fitness(grids: NDArray[np.int8]) -> NDArray[np.int32]:
        grids, result = np.ascontiguousarray(grids), np.empty(len(grids), np.int32)
        sizes = [ctypes.c_int64(size) for size in grids.shape]
        call(ctypes.c_void_p(grids.ctypes.data), ctypes.c_void_p(result.ctypes.data), *sizes)
        return result

    return fitness
