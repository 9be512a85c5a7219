"""Files of any content: no traceback, no hang over 5 s, no memory over 1 GB.

A reader may only return, or raise an `InputError` of one line. Mutations of good files get further than random bytes.
"""

import multiprocessing
import os
import struct
import sys
import time
import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as hypothesis_seed
from hypothesis import strategies as st
from refusals import refused

from elitelanes_jax import InputError, Result, RoadMap, read_map
from elitelanes_jax._util.npz import npz_bytes, read_npz
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.formats.road_map import Drawn, map_to_json
from elitelanes_jax.problem.fixed_cells import parse_fixed_cells
from elitelanes_jax.tiles.files import read_mask
from elitelanes_jax.tiles.rendering import png_of
from elitelanes_jax.tiles.tileset import inspect_tiles

CODES = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8)
DRAWN = Drawn("s", [["turn_1"] * 3] * 3, [[0] * 3] * 3)
MAP = map_to_json(RoadMap(CODES, {"edges": 8}, -3, {"edges": 8}, [0], (1, 2), DRAWN)).encode()
YAML = to_duckietown(CODES).encode() + b"objects: {a: {kind: duckie, pos: [1, 2]}}\n"
TOML = b'name = "a"\nlicence = "b"\nblend = false\n'
MASK = png_of(np.full((9, 8), [0, 255] * 4, np.uint8))
ARRAYS = {"grids": CODES[None, None], "fitness": np.zeros((1, 1), np.int32)}
ARCHIVE = npz_bytes(ARRAYS, {"axes": [], "search": {}, "seed": 1})
SECONDS, BYTES = 5, 2**30


def listed(reader):
    """A reader that collects problems, as one that raises the first."""

    def read(file):
        problems = []
        reader(file, None, problems)
        if problems:
            raise InputError("", "", problems[0])

    return read


def tileset(file):
    inspect_tiles(file.parent)


# By the name of the file: what reads it, a good one, and words of its language.
READERS = {
    "map.json": (read_map, MAP, ['"codes"', "[[", "]]", "1e999", "NaN", "null", '"\\ud800"', "-0", "9" * 5000]),
    "fix.json": (parse_fixed_cells, b'{"codes": [[6, 3], [null, 9]]}', ["[[", "null", "{}", "[]", "1e9", "true"]),
    "map.yaml": (read_map, YAML, ["&a ", "*a", "<<: ", "!!int ", "- ", "? ", ": ", "\n ", "%TAG ! a\n", "---", "|"]),
    "tileset.toml": (tileset, TOML, ["a.a.", "[[", "]]", "{", "}", "=", '"""', "inf", "1979-05-27", "0x", "9" * 5000]),
    "mask.png": (listed(read_mask), MASK, ["IDAT", "IEND", "PLTE", "tRNS"]),
    "archive.npz": (Result.load, ARCHIVE, ["PK\x03\x04", "PK\x01\x02", "(9999999999,)", "|O"]),
    "result.npz": (read_npz, ARCHIVE, ["PK\x03\x04", "PK\x05\x06", "'descr'", "(99999999999999999999,)", "O8"]),
}


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


headers = st.builds(
    lambda width, height, depth, colours, interlaced, pixels: (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colours, 0, 0, interlaced))
        + chunk(b"IDAT", zlib.compress(bytes(pixels)))
        + chunk(b"IEND", b"")
    ),
    *[st.sampled_from([0, 1, 7, 64, 4096, 4097, 2**16, 2**31 - 1, 2**32 - 1])] * 2,
    st.sampled_from([0, 1, 2, 4, 8, 16, 255]),
    st.sampled_from([0, 1, 2, 3, 4, 6, 255]),
    st.sampled_from([0, 1, 2]),
    st.sampled_from([0, 1, 8, 72, 4160, 16_650_000]),
)


def members(header, body):
    """An archive whose arrays have any header, whole as a ZIP file."""
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("settings", "grids", "fitness", "valid"):
            archive.writestr(f"{name}.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + body)
    return stream.getvalue()


DTYPES = ["|O", "<U4", "|i1", "<f8", "|V0", "<U0", "<M8[ns]", ",", "i4,f8", "", "a" * 90]
SHAPES = ["()", "(0,)", "(9999999999,)", "(-1,)", "(99999999999999999999,)", "((1,),)", "(1e9,)", "x", "(" * 99]
arrays = st.builds(
    lambda dtype, shape, body: members(
        f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}}}\n".encode(), body
    ),
    st.sampled_from(DTYPES),
    st.sampled_from(SHAPES),
    st.binary(max_size=64),
)


def spoilt(good, words):
    """Mutations of a file: pieces cut out, doubled, turned over or replaced, words put in, once or very often."""
    edits = st.tuples(
        st.integers(0, len(good)),
        st.integers(0, 12),
        st.one_of(st.sampled_from([word.encode() for word in words]), st.binary(max_size=4)),
        st.sampled_from([1, 1, 1, 2, 1000, 50_000]),
    )

    def apply(edits):
        content = good
        for start, cut, word, times in edits:
            content = content[:start] + word * min(times, 1 + 2**18 // (len(word) + 1)) + content[start + cut :]
        return content

    return st.lists(edits, min_size=1, max_size=4).map(apply)


def contents(name):
    _, good, words = READERS[name]
    more = {"mask.png": headers, "archive.npz": arrays, "result.npz": arrays}.get(name, st.binary(max_size=200))
    return st.one_of(spoilt(good, words), more)


def check(name, content, folder):
    file = folder / name
    file.write_bytes(content)
    began, said = time.process_time(), ""
    try:
        READERS[name][0](file)
    except InputError as error:
        said = str(error)
    assert len(said.splitlines()) <= 1
    assert len(said) < 1000 + len(str(file))
    assert time.process_time() - began < SECONDS


def test_the_good_files_are_good(tmp_path):
    for name, (read, good, _) in READERS.items():
        (tmp_path / name).write_bytes(good)
        if name != "archive.npz":  # whose maps need their metrics
            read(tmp_path / name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.mark.parametrize("name", READERS)
def test_spoilt_files_are_refused_in_one_line(name, folder):
    @settings(max_examples=40, suppress_health_check=list(HealthCheck))
    @given(contents(name))
    def run(content):
        check(name, content, folder)

    run()


def hold_limits(name, seconds, folder):
    """Fuzzes for a time, in a process whose memory is limited."""
    import resource  # not on every system

    check(name, READERS[name][1], folder)  # loads what the reader needs
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + BYTES, size + BYTES))
    ends = time.monotonic() + seconds
    seed = 0
    while time.monotonic() < ends:
        seed += 1

        @settings(
            max_examples=50,
            deadline=None,  # `check` has its own
            phases=[Phase.generate],
            derandomize=False,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        @hypothesis_seed(seed)
        @given(contents(name))
        def run(content):
            try:
                check(name, content, folder)
            except MemoryError:
                raise AssertionError("over 1 GB of memory") from None

        run()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the system does not limit memory")
@pytest.mark.parametrize("name", READERS)
def test_spoilt_files_take_no_more_than_their_share(name, folder):
    """Sixty seconds for each, or ``FUZZ_SECONDS``."""
    process = multiprocessing.get_context("spawn").Process(  # a fork of a process with threads may hang
        target=hold_limits, args=(name, float(os.environ.get("FUZZ_SECONDS", "60")), folder)
    )
    process.start()
    process.join()
    assert process.exitcode == 0


def test_archives_that_unpack_to_far_more_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("elitelanes_jax._util.npz.free_memory", lambda: 2**31)
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("grids.npy", "w") as member:
        for _ in range(33):
            member.write(bytes(2**24))
    for name in ("archive.npz", "result.npz"):
        (tmp_path / name).write_bytes(stream.getvalue())
        with refused(tmp_path / name, "...536,870,912... got 553,648,128"):
            READERS[name][0](tmp_path / name)
