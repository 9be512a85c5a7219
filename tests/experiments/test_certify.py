"""The certificates: against enumeration, integer programming, and the searches of the package."""

import json
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from certified import FLAWS, better_than_certified, certificates
from hypothesis import given, settings
from hypothesis import strategies as st
from integer_programme import solve
from oracle import CERTIFICATES, fitness, measure

import elitelanes_jax
from elitelanes_jax.benchmark import find_task
from experiments.search.check_archive import check, rescore
from experiments.search.optimum import OPTIMA

certify = pytest.importorskip("experiments.search.certify", reason="no such system calls", exc_type=ImportError)
certify_pairs = pytest.importorskip("experiments.search.certify_pairs", exc_type=ImportError)
ROOT = Path(__file__).parents[2]
RECORDS = {
    (one["height"], one["width"], one["fill"]): one for one in json.loads(CERTIFICATES.read_text())["certificates"]
}


def by_niche(record, name):
    return {niche["cyclomatic"]: niche[name] for niche in record["niches"]}


def networks(height, width, fill):
    return by_niche(RECORDS[height, width, fill], "networks")


def consistent_grids(height, width):
    """All grids without mismatch, boundary violation or tile of one connection, cell by cell."""
    codes = [code for code in range(16) if code.bit_count() != 1]
    grid = np.zeros((height, width), np.int8)

    def place(number):
        if number == height * width:
            yield grid.copy()
            return
        row, column = divmod(number, width)
        north = row > 0 and grid[row - 1, column] & 2 > 0
        west = column > 0 and grid[row, column - 1] & 4 > 0
        for code in codes:
            leaves = (code & 4 and column == width - 1) or (code & 2 and row == height - 1)
            if not leaves and (code & 8 > 0) == north and (code & 1 > 0) == west:
                grid[row, column] = code
                yield from place(number + 1)

    return np.array(list(place(0)))


@cache
def enumerated():
    """All grids of 4 x 4, which have smaller ones in a corner; fitness, cyclomatic number, and whether flawless."""
    grids = consistent_grids(4, 4)
    found = jax.vmap(elitelanes_jax.measure)(grids)
    flawless = np.array(found.components == 1)
    for name in FLAWS:
        flawless &= np.asarray(getattr(found, name)) == 0
    return grids, np.asarray(elitelanes_jax.fitness(found)), np.asarray(found.cyclomatic), flawless


@pytest.mark.parametrize(("height", "width"), [(3, 3), (3, 4), (4, 4)])
@pytest.mark.parametrize("fill", [True, False])
def test_enumeration_finds_the_same(height, width, fill):
    grids, values, cyclomatic, flawless = enumerated()
    here = flawless & ~grids[:, height:].any(axis=(1, 2)) & ~grids[:, :, width:].any(axis=(1, 2))
    if fill:
        here &= (grids[:, :height, :width] > 0).all(axis=(1, 2))
    niches = np.unique(cyclomatic[here]).tolist()
    assert certificates()[height, width, fill] == {k: values[here & (cyclomatic == k)].min() for k in niches}
    assert networks(height, width, fill) == {k: (here & (cyclomatic == k)).sum() for k in niches}


@pytest.mark.parametrize("fill", [True, False])
@pytest.mark.parametrize(
    "tiles",
    [pytest.param("turns", marks=pytest.mark.slow), pytest.param("crossings", marks=pytest.mark.slow), "straights"],
)
def test_enumeration_finds_the_same_niches_of_two_descriptors(tiles, fill):
    """Networks with a bridge do not count. Without all cells filled, smaller grids of the corner are included."""
    grids, values, cyclomatic, flawless = enumerated()
    counts = {"turns": (3, 6, 9, 12), "straights": (5, 10), "crossings": (7, 11, 13, 14, 15)}
    number = np.isin(grids, counts[tiles]).sum(axis=(1, 2))
    here = np.array([good and measure(grid)["bridges"] == 0 for grid, good in zip(grids, flawless, strict=True)])
    if fill:
        here &= (grids > 0).all(axis=(1, 2))
    expected = {}
    for niche, value in zip(
        zip(cyclomatic[here].tolist(), number[here].tolist(), strict=True), values[here], strict=True
    ):
        known = expected.get(tuple(niche), [0, 0])
        expected[tuple(niche)] = [min(known[0], value), known[1] + 1]
    size = f"4x4{'A' if fill else 'B'}-{tiles}"
    for thin in (True, False):
        record = certify_pairs.certify_pair(size, thin=thin)
        found = {(one["cyclomatic"], one["tiles"]): [one["optimum"], one["networks"]] for one in record["niches"]}
        assert found == expected and certify_pairs.name_of(record) == size


def test_the_program_that_lists_networks_has_the_same_optima(tmp_path):
    """`enumerate.cpp` shares no code with the sweep."""
    program, source = tmp_path / "enumerate", ROOT / "experiments" / "search" / "enumerate.cpp"
    if not shutil.which("g++"):
        pytest.skip("no compiler")
    subprocess.run(["g++", "-O2", "-std=c++20", source, "-o", program], check=True)
    lines = subprocess.run([program, "5", "5"], check=True, capture_output=True, text=True).stdout.splitlines()
    for name in ("5x5B-straights", "5x5B-turns"):
        record = certify_pairs.certify_pair(name)
        assert certify_pairs.compare(record, lines) == len(record["niches"])
        record["niches"][0]["optimum"] -= 2
        with pytest.raises(ArithmeticError, match=f"{name}: enumeration and certificate differ at "):
            certify_pairs.compare(record, lines)
    counted = sum(int(line.split()[3]) for line in lines)
    assert counted == sum(networks(5, 5, False).values())


def test_the_certificates_of_two_descriptors_are_made_again(tmp_path, capsys):
    packaged = ROOT / "elitelanes_jax" / "benchmark" / "certificates-2.json"
    assert certify_pairs.main(["5x5B-straights", "--out", str(tmp_path / "one.json")]) == 0
    (record,) = json.loads((tmp_path / "one.json").read_text())["certificates"]
    assert record in json.loads(packaged.read_text())["certificates"]
    with pytest.raises(SystemExit):
        certify_pairs.main(["5x5B-bridges"])
    assert "expected a size and one of turns, crossings, straights, got '5x5B-bridges'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(("cyclomatic", "straights"), [(2, 8), (3, 10), (6, 4)])
def test_integer_programming_proves_the_same_optima_of_two_descriptors(cyclomatic, straights):
    task = find_task("6x6B-straights-10000")
    (index,) = np.flatnonzero((task.niches == [cyclomatic, straights]).all(axis=1))
    value = solve(6, 6, False, cyclomatic, seconds=300, counted=("straights", straights))
    assert value in (None, task.optimum[index])


@pytest.mark.parametrize("size", [(3, 4, False), (4, 5, True), (4, 4, False), (5, 5, True)])
def test_the_programme_makes_the_certificates_again(size):
    record, slow = certify.certify(size), certify.certify(size, thin=False)
    assert certify.certify(size)["niches"] == record["niches"]
    for name in ("optimum", "networks"):
        assert by_niche(record, name) == by_niche(slow, name) == by_niche(RECORDS[size], name)
    assert slow["cost"]["states"] >= record["cost"]["states"]


@pytest.mark.parametrize("size", RECORDS)
def test_each_optimum_has_a_network(size):
    height, width, fill = size
    for niche in RECORDS[size]["niches"]:
        grid = np.array([[int(code, 16) for code in row] for row in niche["witness"]])
        assert grid.shape == size[:2]
        found = measure(grid)
        assert fitness(found) == niche["optimum"]
        assert found["components"] == 1 and found["cyclomatic"] == niche["cyclomatic"]
        assert not any(found[name] for name in FLAWS)
        assert grid.all() or not size[2]
        assert (niche["networks"] is None) == (height * width > (81 if fill else 64))
        assert niche["networks"] is None or niche["networks"] >= 1


def test_all_sizes_are_there_and_agree_with_each_other():
    assert set(RECORDS) >= set(certify.SIZES)
    for height, width, fill in RECORDS:
        if fill and (height, width, False) in RECORDS:
            some = certificates()[height, width, False]
            assert all(some[niche] <= value for niche, value in certificates()[height, width, True].items())
        larger = RECORDS.get((height, width + 1, False))
        if not fill and larger:  # a network may lie in a corner of a larger grid
            some = by_niche(larger, "optimum")
            assert all(some[niche] <= value for niche, value in certificates()[height, width, False].items())
    for fill, optima in OPTIMA.items():  # proven before, by another programme
        for side, value in optima.items():
            assert (side, side, fill) not in RECORDS or min(certificates()[side, side, fill].values()) == value


@pytest.mark.slow
@pytest.mark.parametrize(("side", "fill"), [(5, True), (5, False), (6, True), (6, False)])
def test_integer_programming_proves_the_same(side, fill):
    """Proofs that end within five minutes count."""
    certified, proven = certificates()[side, side, fill], set()
    for cyclomatic in range(1, max(certified) + 2):
        value = solve(side, side, fill, cyclomatic, seconds=300)
        assert value in (None, certified.get(cyclomatic, np.inf))
        proven |= {cyclomatic} if value is not None else set()
    assert proven & set(certified)


def test_a_search_that_beats_a_certificate_is_noticed():
    """`better_than_certified` watches the searches of the tests, see certified.py."""
    grids = witnesses(5, 5, False)
    metrics = jax.vmap(elitelanes_jax.measure)(grids)
    elites = SimpleNamespace(grids=grids, valid=np.ones(len(grids), bool), metrics=metrics)
    assert not better_than_certified(elites)
    better = metrics.straight_score + np.array([0, 1, 0, 0, 0])
    elites.metrics = metrics._replace(straight_score=better)
    assert better_than_certified(elites) == [(2, -80)]
    elites.metrics = elites.metrics._replace(cyclomatic=metrics.cyclomatic + np.array([0, 0, 0, 0, 1]))
    assert better_than_certified(elites) == [(2, -80), (6, -28)]


@settings(max_examples=50)
@given(st.integers(0, 2**16 - 1), st.booleans())
def test_the_checker_measures_as_the_oracle(number, repaired):
    grid = np.random.default_rng(number).integers(0, 16, (4, 5))
    if repaired:
        grid = np.asarray(elitelanes_jax.repair(grid.astype(np.int8), np.zeros(grid.shape, bool))).astype(int)
    found, score = measure(grid), rescore(grid)
    flawless = found["components"] == 1 and not any(found[name] for name in FLAWS)
    assert score == (fitness(found), found["cyclomatic"], flawless, bool(grid.all()), found["bridges"])


def witnesses(height, width, fill):
    niches = RECORDS[height, width, fill]["niches"]
    return np.array([[[int(code, 16) for code in row] for row in niche["witness"]] for niche in niches], np.int8)


def test_the_checker_says_when_a_certificate_is_wrong():
    grids, optima = witnesses(5, 5, True), certificates()[5, 5, True]
    assert check(optima, grids, fill=True) == ({number: [value] for number, value in optima.items()}, [])
    first = min(optima)
    faults = check({first: optima[first] + 2}, grids, fill=True)[1]
    assert [line.split(", got")[0] for line in faults[:2]] == [
        "cyclomatic number 3: certified -54 at best",
        "cyclomatic number 4: certified no network",
    ]


@pytest.mark.parametrize("text", ["8x8", "8x8C", "1x8A", "15x15A", "eight"])
def test_it_refuses_sizes(text, capsys):
    with pytest.raises(SystemExit) as error:
        certify.main([text])
    assert error.value.code == 2
    assert "expected a size such as 8x8A" in capsys.readouterr().err


def test_the_program_keeps_what_is_there(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(certify, "ProcessPoolExecutor", lambda workers, mp_context: ThreadPoolExecutor(workers))
    out, tables = tmp_path / "some.json", tmp_path / "some.md"
    assert certify.main(["3x3A", "--out", str(out)]) == 0
    first = out.read_bytes()
    assert certify.main(["3x3A", "--out", str(out), "--table", str(tables)]) == 0
    assert out.read_bytes() == first
    assert "| 3 x 3 A |  | -10 |" in tables.read_text()
    assert capsys.readouterr().out.splitlines()[0].startswith("3 x 3 A: {2: -10}")
    out.write_text("[]")
    assert certify.main(["3x3A", "--out", str(out)]) == 2
    assert "expected certificates" in capsys.readouterr().err
