"""The table of versions that the tests ran with."""

import sys

import everything
import pytest

MAKE = """#!/bin/sh
[ "$1" = broken ] && exit 2
case='<testcase classname="tests.a.test_b" name="test_c[one|two]"><failure/></testcase>'
good='<testcase classname="tests.a.test_b" name="test_d"/>'
printf '<testsuites><testsuite tests="9" skipped="2" failures="%s" errors="0" time="90">%s</testsuite></testsuites>' \\
  "$([ "$1" = bad ] && echo 3 || echo 0)" "$([ "$1" = bad ] && echo "$case$case" || echo "$good")" \\
  > "${PYTEST_ADDOPTS##*=}"
[ "$1" != bad ]
"""


@pytest.fixture
def page(tmp_path, monkeypatch):
    (tmp_path / "make").write_text(MAKE)
    (tmp_path / "make").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    names = ("good", "bad", "broken")
    monkeypatch.setattr(everything, "ENVIRONMENTS", {name: everything.Environment(sys.prefix) for name in names})
    monkeypatch.setattr(everything, "PAGE", tmp_path / "docs" / "tested.md")
    everything.PAGE.parent.mkdir()
    return everything.PAGE


@pytest.mark.skipif(sys.platform == "win32", reason="no such scripts")
def test_each_environment_has_a_row_that_says_how_it_went(page, capsys):
    assert everything.main(["good", "nothing"]) == 2 and not page.exists()
    assert capsys.readouterr().err == "ENVIRONMENTS: expected some of good, bad, broken, got nothing\n"
    assert everything.main(["bad", "good"]) == 1
    assert everything.main(["good"]) == 0
    good, bad = [line.split(" | ") for line in page.read_text().splitlines() if line.startswith("| `")]
    assert good[0] == "| `good`" and good[1] == sys.version.split()[0] and "jax " in good[2] and "numpy " in good[2]
    assert good[3:7] == ["7", "2", "0", "1.5"]
    assert bad[0] == "| `bad`" and bad[3:7] == ["4", "2", "3: `tests.a.test_b.test_c`", "1.5"]
    assert everything.main() == 1
    assert "| 0 | 0 | all | 0 |" in page.read_text().splitlines()[-1]
