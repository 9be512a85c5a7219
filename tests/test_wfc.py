"""Wave Function Collapse: its constraints, its failures, its chances."""

import numpy as np
import pytest
from oracle import OPPOSITE, STEPS
from oracle import measure as oracle

from elitelanes_jax import InputError
from elitelanes_jax.codes import CONNECTIONS, CROSSINGS, ROAD_ALPHABET
from elitelanes_jax.wfc import _inside, _propagate, _rules, _start, generate, generate_batch


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
    if not result.solvable:
        assert not result.success.any()
        assert (result.attempts == 0).all()
    elif alphabet != (5, 10, 15) or border == "open":
        assert result.success.all()


def test_one_is_a_batch_of_one():
    for seed in range(5):
        one = generate(np.random.default_rng(seed), (5, 6), border="closed")
        many = generate_batch(np.random.default_rng(seed), 1, (5, 6), border="closed")
        np.testing.assert_array_equal(one.grid, many.grid[0])
        assert (one.success, one.attempts) == (many.success[0], many.attempts[0])
    assert (type(one.success), type(one.attempts), one.grid.shape) == (bool, int, (5, 6))


def test_the_same_generator_gives_the_same_grids():
    one, other = (generate_batch(np.random.default_rng(3), 9, (6, 6)).grid for _ in range(2))
    np.testing.assert_array_equal(one, other)
    assert (one != generate_batch(np.random.default_rng(4), 9, (6, 6)).grid).any()


def test_a_closed_border_with_the_ban_nearly_always_succeeds():
    result = generate_batch(np.random.default_rng(5), 1000, border="closed")
    assert result.success.mean() >= 0.99
    assert 1 < result.attempts.mean() < 1.5
    assert result.attempts.max() <= 10


def test_large_grids():
    result = generate(np.random.default_rng(6), (64, 64), border="closed", attempts=50)
    assert result.success
    assert keeps_the_constraints(result.grid, ROAD_ALPHABET, "closed", True)


def test_bad_luck_is_a_result():
    """Rings alone cannot fill an odd number of cells, which no table of neighbours tells."""
    rings = (3, 5, 6, 9, 10, 12)
    result = generate_batch(np.random.default_rng(7), 6, (3, 5), alphabet=rings, border="closed", attempts=4)
    assert result.solvable
    assert not result.success.any()
    assert (result.attempts == 4).all()
    assert not result.grid.any()
    assert generate_batch(np.random.default_rng(7), 6, (4, 5), alphabet=rings, border="closed").success.any()


@pytest.mark.parametrize(
    ("alphabet", "border", "ban"),
    [((3,), "open", True), ((15,), "open", True), ((5,), "closed", True), ((7, 13), "closed", False)],
)
def test_what_cannot_be_solved_is_told_apart(alphabet, border, ban):
    result = generate(np.random.default_rng(8), (4, 4), alphabet=alphabet, border=border, crossing_ban=ban)
    assert (result.success, result.attempts, result.solvable) == (False, 0, False)


def test_a_contradiction_stays_in_its_grid():
    """Some grids of a batch fail at their only attempt, their neighbours in memory do not."""
    result = generate_batch(np.random.default_rng(9), 400, (8, 8), border="closed", attempts=1)
    assert 0.5 < result.success.mean() < 1
    assert (result.attempts == 1).all()
    for grid in result.grid[result.success]:
        assert keeps_the_constraints(grid, ROAD_ALPHABET, "closed", True)


def struck_out(domains, alphabet, border, ban):
    """Arc consistency by its definition: a code goes that has no partner in a neighbour, until none goes."""
    domains = {place: set(codes) for place, codes in domains.items()}
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


@pytest.mark.parametrize("border", ["open", "closed"])
@pytest.mark.parametrize("ban", [False, True])
def test_propagation_is_arc_consistency(border, ban):
    rng, shape, stride = np.random.default_rng(10), (4, 5), 6
    rules = _rules(ROAD_ALPHABET, border, ban)
    inside = np.flatnonzero(_inside(shape))
    for _ in range(40):
        cells = _start(ROAD_ALPHABET, border, ban, shape).copy()
        for place in rng.choice(inside, rng.integers(1, 6), replace=False):
            held = [bit for bit in range(11) if cells[place] >> bit & 1]
            kept = rng.choice(held, rng.integers(1, len(held) + 1), replace=False) if held else []
            cells[place] = sum(1 << int(bit) for bit in kept)
            before = {
                (place // stride - 1, place % stride): {
                    ROAD_ALPHABET[bit] for bit in range(11) if cells[place] >> bit & 1
                }
                for place in inside
            }
            _propagate(rules, cells, np.array([place]), stride)
            expected = struck_out(before, ROAD_ALPHABET, border, ban)
            found = {
                (place // stride - 1, place % stride): {
                    ROAD_ALPHABET[bit] for bit in range(11) if cells[place] >> bit & 1
                }
                for place in inside
            }
            if not all(expected.values()):
                assert not all(found.values())
                break
            assert found == expected


def test_each_option_of_a_domain_has_one_place():
    rules = _rules(ROAD_ALPHABET, "open", False)
    full = rules.guard - 1
    assert rules.options[full] == 11
    assert sorted(rules.option[full].tolist()) == [1 << bit for bit in range(11)]
    for domain in (full, 0b101, 0b11000000001):
        held = [1 << bit for bit in range(11) if domain >> bit & 1]
        assert rules.option[domain][: rules.options[domain]].tolist() == held


def test_tiles_without_constraints_are_uniform():
    """Where every code fits beside every other, here by a table that allows all, each is equally frequent."""
    import elitelanes_jax.wfc as wfc

    rules = _rules(ROAD_ALPHABET, "open", False)
    free = rules._replace(allowed=np.full_like(rules.allowed, 2 * rules.guard - 1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wfc, "_rules", lambda *_: free)
        grids = generate_batch(np.random.default_rng(11), 400, (6, 7), crossing_ban=False).grid
    counts = np.bincount(grids.ravel(), minlength=16)
    assert tuple(np.flatnonzero(counts)) == ROAD_ALPHABET
    expected = grids.size / 11
    # Chi square with 10 degrees of freedom: over 29.6 once in a thousand seeds.
    assert ((counts[list(ROAD_ALPHABET)] - expected) ** 2 / expected).sum() < 29.6


def test_equally_uncertain_cells_take_turns_at_random():
    """Every cell of an open grid starts alike: each is the first to be chosen equally often."""
    import elitelanes_jax.wfc as wfc

    first = []

    def watch(rules, cells, changed, stride):
        if not first:
            first.append(changed % (cells.size // 4000))
        return _propagate(rules, cells, changed, stride)

    with pytest.MonkeyPatch.context() as patch:
        _start(ROAD_ALPHABET, "open", True, (4, 5))
        patch.setattr(wfc, "_propagate", watch)
        generate_batch(np.random.default_rng(12), 4000, (4, 5))
    counts = np.bincount(first[0], minlength=36)
    inside = _inside((4, 5))
    assert not counts[~inside].any()
    assert (abs(counts[inside] - 200) < 5 * np.sqrt(200)).all()


def test_the_papers_figures():
    """The specification's means within 10 %, no linked crossings, no dead end but at the border."""
    result = generate_batch(np.random.default_rng(13), 1000)
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
    ("change", "message"),
    [
        ({"shape": (1, 5)}, "shape: expected sides from 2 to 1024, got 1 x 5"),
        ({"alphabet": [3, 16]}, "alphabet: expected tile codes"),
        ({"border": "ajar"}, "border: expected 'open' or 'closed', got 'ajar'"),
        ({"attempts": 0}, "expected attempts to be a whole number, 1 or more, got 0"),
        ({"n": 0}, "expected n to be a whole number, 1 or more, got 0"),
        ({"rng": 3}, "rng: expected a numpy.random.Generator, got int"),
    ],
)
def test_bad_arguments_are_named(change, message):
    arguments = {"rng": np.random.default_rng(0), "n": 2} | change
    with pytest.raises(InputError, match=message):
        generate_batch(**arguments)
