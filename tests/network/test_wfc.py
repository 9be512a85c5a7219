"""Wave Function Collapse: its constraints, its failures, its chances."""

from collections import Counter
from functools import cache
from itertools import product

import numpy as np
import pytest
from oracle import OPPOSITE, STEPS
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax.network.codes import CONNECTIONS, CROSSINGS, ROAD_ALPHABET
from elitelanes_jax.network.wfc import generate_batch


def keeps_the_constraints(grid, alphabet, border, ban):
    """Tile by tile, side by side."""
    height, width = grid.shape
    for row, column in np.ndindex(grid.shape):
        code = int(grid[row, column])
        if code not in alphabet:
            return False
        for side, (down, right) in STEPS.items():
            beside = row + down, column + right
            if not (0 <= beside[0] < height and 0 <= beside[1] < width):
                if border == "closed" and code & side:
                    return False
                continue
            other = int(grid[beside])
            if bool(code & side) != bool(other & OPPOSITE[side]):
                return False
            if ban and code & side and code in CROSSINGS and other in CROSSINGS:
                return False
    return True


CASES = [
    (shape, alphabet, border, ban)
    for shape in ((2, 2), (2, 7), (5, 4), (12, 12))
    for alphabet in (ROAD_ALPHABET, tuple(range(16)), (0, 3, 5, 6, 9, 10, 12), (5, 10, 15))
    for border in ("open", "closed")
    for ban in (False, True)
]


@pytest.mark.parametrize(("shape", "alphabet", "border", "ban"), CASES, ids=str)
def test_what_succeeds_keeps_the_constraints(shape, alphabet, border, ban):
    rng = np.random.default_rng(1)
    result = generate_batch(rng, 20, shape, alphabet=alphabet, border=border, crossing_ban=ban, attempts=50)
    assert result.grid.shape == (20, *shape)
    assert result.grid.dtype == np.int8
    for grid, success in zip(result.grid, result.success, strict=True):
        assert not success or keeps_the_constraints(grid, alphabet, border, ban)
        assert success or not grid.any()
    assert result.solvable == all(all_domains(shape, alphabet, border, ban).values())
    if not result.solvable:
        assert not result.success.any()
        assert (result.attempts == 0).all()
    elif alphabet != (5, 10, 15) or border == "open":
        assert result.success.all()


def test_a_closed_border_with_the_ban_nearly_always_succeeds_and_the_same_every_time():
    result, again = (generate_batch(np.random.default_rng(5), 1000, border="closed") for _ in range(2))
    np.testing.assert_array_equal(result.grid, again.grid)
    assert result.success.mean() >= 0.99
    assert 1 < result.attempts.mean() < 1.5
    assert result.attempts.max() <= 10


def test_bad_luck_is_a_result():
    """Rings alone cannot fill an odd number of cells, which no table of neighbours tells."""
    rings = (3, 5, 6, 9, 10, 12)
    result = generate_batch(np.random.default_rng(7), 6, (3, 5), alphabet=rings, border="closed", attempts=4)
    assert result.solvable
    assert not result.success.any()
    assert (result.attempts == 4).all()
    assert not result.grid.any()
    assert generate_batch(np.random.default_rng(7), 6, (4, 5), alphabet=rings, border="closed").success.any()


def struck_out(domains, alphabet, border, ban):
    """Arc consistency by its definition: a code goes that has no partner in a neighbour, until none goes."""
    domains = {cell: set(codes) for cell, codes in domains.items()}
    changed = True
    while changed:
        changed = False
        for (row, column), codes in domains.items():
            for code in sorted(codes):
                for side, (down, right) in STEPS.items():
                    others = domains.get((row + down, column + right))
                    if others is None:
                        fits = border == "open" or not code & side
                    else:
                        fits = any(
                            bool(code & side) == bool(other & OPPOSITE[side])
                            and not (ban and code & side and code in CROSSINGS and other in CROSSINGS)
                            for other in others
                        )
                    if not fits:
                        codes.discard(code)
                        changed = True
                        break
    return domains


def all_domains(shape, alphabet, border, ban):
    return struck_out(dict.fromkeys(np.ndindex(shape), alphabet), alphabet, border, ban)


def chances(shape, alphabet, border, ban):
    """The chance of each grid at the first attempt by the definition; a contradiction is None."""

    @cache
    def from_here(state):
        domains = dict(zip(np.ndindex(shape), state, strict=True))
        if not all(domains.values()):
            return {None: 1.0}
        smallest = min((len(codes) for codes in state if len(codes) > 1), default=0)
        if not smallest:
            return {tuple(code for codes in state for code in codes): 1.0}
        cells = [cell for cell, codes in domains.items() if len(codes) == smallest]
        found = Counter()
        for cell, code in product(cells, range(smallest)):
            chosen = domains | {cell: {sorted(domains[cell])[code]}}
            after = struck_out(chosen, alphabet, border, ban)
            for grid, chance in from_here(tuple(map(frozenset, after.values()))).items():
                found[grid] += chance / len(cells) / smallest
        return found

    return from_here(tuple(map(frozenset, all_domains(shape, alphabet, border, ban).values())))


@pytest.mark.parametrize(
    ("shape", "alphabet", "border", "ban"),
    [
        ((2, 2), (0, 3, 5, 6, 7, 9, 12, 14), "open", True),
        ((2, 2), (0, 2, 5, 7, 13, 15), "open", False),
        ((3, 2), (0, 1, 2, 3, 6, 7, 8, 9, 12, 14), "closed", True),
        ((3, 3), (0, 2, 5, 9, 12, 13), "closed", False),  # every ninth attempt is a contradiction
        ((3, 4), (3, 5, 6, 7, 9, 10, 11, 12, 13, 14), "closed", False),
    ],
    ids=str,
)
def test_every_grid_comes_with_its_chance(shape, alphabet, border, ban):
    """The cell with the fewest codes is next, all such cells alike, then all its codes alike, then arc consistency."""
    expected, count = chances(shape, alphabet, border, ban), 20_000
    assert sum(expected.values()) == pytest.approx(1)
    rng = np.random.default_rng(11)
    result = generate_batch(rng, count, shape, alphabet=alphabet, border=border, crossing_ban=ban, attempts=1)
    found = Counter(
        tuple(grid.ravel().tolist()) if success else None
        for grid, success in zip(result.grid, result.success, strict=True)
    )
    assert set(found) <= set(expected)
    observed = np.array([found[grid] for grid in expected])
    wanted = count * np.array(list(expected.values()))
    rare = wanted < 5
    observed, wanted = (np.append(counts[~rare], counts[rare].sum()) for counts in (observed, wanted))
    square = ((observed - wanted) ** 2 / np.maximum(wanted, 1)).sum()
    degrees = len(wanted) - 1
    assert square < degrees + 4 * np.sqrt(2 * degrees)


def test_the_papers_figures():
    """The specification's means within 10 %, no linked crossings, no dead end but at the border."""
    result = generate_batch(np.random.default_rng(13), 200)
    assert result.success.all()
    figures = [oracle(grid) for grid in result.grid]
    mean = {name: np.mean([figure[name] for figure in figures]) for name in figures[0]}
    assert all(figure["dead_ends"] == figure["boundary_violations"] for figure in figures)
    assert mean["adjacent_crossing_score"] == mean["mismatches"] == 0
    for name, expected in (
        ("boundary_violations", 26.3),
        ("crossings", 32.5),
        ("straight_score", 38),
        ("adjacent_turns", 79),
    ):
        assert mean[name] == pytest.approx(expected, rel=0.1)
    assert (CONNECTIONS[result.grid] >= 2).all()


@pytest.mark.parametrize(
    ("change", "subject", "got", "expected"),
    [
        ({"shape": (1, 5)}, "shape", "1 x 5", "new maps"),
        ({"alphabet": [3, 16]}, "alphabet", "16", ""),
        ({"border": "ajar"}, "border", "'ajar'", ""),
        ({"attempts": 0}, "attempts", "0", ""),
        ({"n": 0}, "n", "0", ""),
        ({"rng": 3}, "rng", "int", ""),
        ({"crossing_ban": "no"}, "crossing_ban", "'no'", ""),
    ],
)
def test_bad_arguments_are_named(any_types, change, subject, got, expected):
    arguments = {"rng": np.random.default_rng(0), "n": 2} | change
    with refused(subject, got, expected):
        generate_batch(**arguments)
