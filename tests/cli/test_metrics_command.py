"""The command ``metrics``, its page, and the maps behind its ranges."""

from pathlib import Path

import pytest
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax.cli.main import main
from elitelanes_jax.formats.sketch import draw_text
from elitelanes_jax.network.records import largest_metrics
from elitelanes_jax.problem.extremes import describe_features, extreme_maps, feature_range, features_of
from elitelanes_jax.problem.features import FEATURES, SHARES, TOWN_FEATURES

PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"


def test_the_page_lists_what_the_code_has():
    rows = [line for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    assert rows == [f"| `{name}` | {meaning} | {values} |" for name, (meaning, values) in describe_features().items()]
    assert len(rows) == len(FEATURES) + len(TOWN_FEATURES)


@pytest.mark.parametrize("name", FEATURES)
def test_a_range_ends_with_maps_that_generate_could_write(name):
    low, high = feature_range(name)
    for grid, value in zip(extreme_maps(name), (low, high), strict=True):
        assert grid.shape == (12, 12) and not grid.flags.writeable
        metrics = oracle(grid)
        flaws = ("dead_ends", "boundary_violations", "mismatches", "empty_cells", "off_alphabet")
        assert metrics["components"] == 1
        assert not any(metrics[flaw] for flaw in flaws)
        part, whole = SHARES.get(name, (name, ()))
        assert value == (metrics[part] / sum(metrics[other] for other in whole) if whole else metrics[part])
        assert features_of(grid)[name] == value
    assert 0 <= low <= high <= (1 if name in SHARES else largest_metrics((12, 12))[name])


def test_ranges_that_are_known():
    """All links, and a ring through all cells: no map has more crossings or fewer."""
    assert {name: feature_range(name) for name in ("cyclomatic", "crossings", "edges", "unlinked_neighbours")} == {
        "cyclomatic": (1, 121),
        "crossings": (0, 140),
        "edges": (144, 264),
        "unlinked_neighbours": (0, 120),
    }
    assert feature_range("turns")[0] == 4
    assert feature_range("coverage") == (1, 1)


@pytest.mark.parametrize("name", describe_features())
def test_a_feature_that_is_listed_has_a_range_or_says_that_it_has_none(name):
    for function in (feature_range, extreme_maps):
        if name in FEATURES:
            assert len(function(name)) == 2
        else:
            with refused("name", f"'{name}', a town feature, ..."):
                function(name)


def test_all_are_listed_and_one_is_shown(capsys):
    assert main(["metrics"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, (_, values) in describe_features().items():
        assert [line for line in lines if line.split("  ")[0] == name and f"  {values}  " in line], name
    assert max(map(len, lines)) <= 110
    assert main(["metrics", "bridges"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("bridges: cut-edges, ")
    for grid in extreme_maps("bridges"):
        assert all(line in shown for line in draw_text(grid).splitlines())
    assert main(["metrics", "mean_street"]) == 0
    assert "a ratio; measured only in searches that name it" in capsys.readouterr().out
    assert main(["metrics", "components"]) == 0
    assert "all maps of generate have this value" in capsys.readouterr().out
    assert main(["metrics", "coverage"]) == 0
    assert "without empty cells have this value. With --rules," in capsys.readouterr().out
    assert main(["metrics", "bridge"]) == 2
    assert "got 'bridge'; is it bridges? elitelanes metrics explains all: " in capsys.readouterr().err
