"""The environments of `make everything` are targets of make, and workflows run them all."""

import re
from pathlib import Path

from everything import ENVIRONMENTS

REPOSITORY = Path(__file__).parents[1]


def test_environments_are_targets_of_make():
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    (phony,) = re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)
    assert set(phony.split()) >= set(ENVIRONMENTS)
    recipes = re.findall(r"^([a-z0-9-]+):.*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    runs_tests = {target for target, recipe in recipes if "-m pytest" in recipe}
    assert runs_tests - {"notebooks", "explorer"} == set(ENVIRONMENTS)  # these two run in `make test`'s environment


def test_workflows_run_all_environments():
    run = set()
    for file in (REPOSITORY / ".github" / "workflows").glob("*.yml"):
        text = file.read_text(encoding="utf-8")
        run |= set(re.findall(r"run: make ([a-z0-9-]+)", text))
        for targets in re.findall(r"target:\s*\[([^]]*)\]", text):
            run |= set(re.split(r",\s*", targets))
    assert run >= set(ENVIRONMENTS)
