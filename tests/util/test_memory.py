"""The memory that is free, and errors that say that there is too little."""

import sys
from pathlib import Path

import pytest

from elitelanes_jax._util import memory
from elitelanes_jax._util.memory import free_memory, is_out_of_memory


@pytest.mark.skipif(sys.platform != "linux", reason="the system does not tell")
def test_what_is_free_is_no_more_than_a_limit(monkeypatch):
    resource = pytest.importorskip("resource")
    assert 2**24 < free_memory() < 2**48
    monkeypatch.setattr(resource, "getrlimit", lambda _: (2**34, 2**34))
    assert free_memory() < 2**34
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1, 1))
    assert free_memory() == 0


@pytest.mark.skipif(sys.platform != "linux", reason="no such groups")
def test_a_container_has_a_limit(tmp_path, monkeypatch):
    whole = free_memory()
    lines = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    group = tmp_path / next((line.removeprefix("0::/") for line in lines if line.startswith("0::")), "none")
    if group.name == "none":
        pytest.skip("this system has groups of another version")
    group.mkdir(parents=True, exist_ok=True)
    monkeypatch.setattr(memory, "_GROUPS", tmp_path)
    (group / "memory.current").write_text("900000")
    (group / "memory.stat").write_text("file 7\ninactive_file 300000\n")
    (group / "memory.max").write_text("max")
    assert free_memory() > whole // 2
    (group / "memory.max").write_text("1000000")
    assert free_memory() == 400_000


def test_errors_of_memory_are_known():
    assert is_out_of_memory(MemoryError())
    assert is_out_of_memory(RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."))
    assert is_out_of_memory(RuntimeError("INTERNAL: Failed to allocate: Out of memory"))
    assert not is_out_of_memory(RuntimeError("INTERNAL: a bug"))
